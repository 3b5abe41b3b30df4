//! `sortie firmware` on machines where something is missing: it is named, and nothing is installed.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Output;

use crate::support::{BUNDLE, assert_fails, output, sortie, stderr};

/// A folder of programs that are shell scripts.
fn programs(scripts: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, script) in scripts {
        let path = folder.path().join(name);
        fs::write(&path, format!("#!/bin/sh\n{script}\n")).expect("a script");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("a program");
    }
    folder
}

/// Asks for a board where only these programs are found, with a packaged compiler of this name.
fn asked(board: &str, path: &Path, rustc: &Path) -> Output {
    let rustc = rustc.display().to_string();
    let mut command = sortie(&["firmware", BUNDLE, "--board", board, "--rustc", &rustc]);
    command.env("PATH", path).output().expect("the command line starts")
}

/// The packages that an error names.
fn named(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(69), "{}", stderr(output));
    let text = stderr(output);
    let rest = text.split_once("not installed: ").expect("packages are named").1;
    rest.split_once(". ").expect("a sentence").0.to_owned()
}

/// What a toolchain without the board's library prints: its linker lies in this folder.
fn rustup(root: &Path) -> String {
    let linker = root.join("lib/rustlib/made-up/bin");
    fs::create_dir_all(&linker).expect("a folder");
    fs::write(linker.join("rust-lld"), "").expect("a file");
    let root = root.display();
    format!(
        "case \"$*\" in *target-libdir*) echo {root}/none;; *sysroot*) echo {root};; *) echo 'host: made-up';; esac"
    )
}

#[test]
fn missing_packages_are_named_for_each_board() {
    let root = tempfile::tempdir().expect("a temporary folder");
    let path = programs(&[("cargo", "exit 1"), ("rustc", &rustup(root.path()))]);
    let nowhere = path.path().join("no-such-rustc");
    let arm = "rustc-web rust-web-src qemu-system-arm";
    for board in ["cortex-m4f", "cortex-m7", "cortex-m3", "cortex-m0", "aarch64"] {
        assert_eq!(named(&asked(board, path.path(), &nowhere)), arm, "{board}");
    }
    let riscv = "rustc-web rust-web-src qemu-system-misc";
    for board in ["rv32imc", "rv32imafc"] {
        assert_eq!(named(&asked(board, path.path(), &nowhere)), riscv, "{board}");
    }
}

#[test]
fn what_is_there_is_not_named() {
    let root = tempfile::tempdir().expect("a temporary folder");
    let rustc = rustup(root.path());
    let emulator = programs(&[("cargo", "exit 1"), ("rustc", &rustc), ("qemu-system-arm", "")]);
    let path = emulator.path();
    assert_eq!(named(&asked("cortex-m3", path, Path::new("/nowhere"))), "rustc-web rust-web-src");
    // A packaged compiler whose library's sources are missing, then an old one.
    let answers = |version: &str| {
        format!("case $1 in --version) echo rustc {version};; *) echo /nowhere;; esac")
    };
    let packaged = programs(&[("new", &answers("1.96.0")), ("old", &answers("1.63.0"))]);
    let of = |name: &str| named(&asked("cortex-m3", path, &packaged.path().join(name)));
    assert_eq!(of("new"), "rust-web-src");
    assert_eq!(of("old"), "rustc-web rust-web-src");
    // With the toolchain's own library no packaged compiler is asked for.
    let whole = "case \"$*\" in *target-libdir*) echo /;; *) echo rustc 1.96.0;; esac";
    let whole = programs(&[("cargo", "exit 1"), ("rustc", whole)]);
    assert_eq!(named(&asked("rv32imc", whole.path(), Path::new("/nowhere"))), "qemu-system-misc");
}

#[test]
fn without_cargo_or_sources_nothing_is_built() {
    let empty = programs(&[]);
    assert_fails(
        &asked("cortex-m0", empty.path(), Path::new("/nowhere")),
        69,
        &["cargo", "rustup.rs"],
    );
    let elsewhere = empty.path().display().to_string();
    let refused = output(&["firmware", BUNDLE, "--board", "cortex-m0", "--sources", &elsewhere]);
    assert_fails(&refused, 66, &["--sources", "runtime/firmware", env!("CARGO_PKG_VERSION")]);
}

#[test]
fn wrong_uses_are_refused() {
    let fused = output(&["firmware", BUNDLE, "--board", "cortex-m4f", "--profile", "fused"]);
    assert_fails(&fused, 2, &["exact", "int8"]);
    let table = output(&["firmware", BUNDLE, "--board", "cortex-m4f", "--write"]);
    assert_fails(&table, 2, &["required arguments"]);
    assert!(stderr(&table).contains("--table"), "{}", stderr(&table));
    assert_fails(&output(&["firmware", "nowhere", "--board", "cortex-m4f"]), 66, &["nowhere"]);
    let plain = |more: &[&str]| output(&[&["firmware", "--board", "cortex-m4f"], more].concat());
    assert_fails(&plain(&["examples/embed_c/cart.onnx"]), 2, &["sortie compile"]);
    let plan = "examples/embed_c/cart.plan";
    assert_fails(&plain(&[plan, "--profile", "int8"]), 2, &["profile `exact`"]);
    let allocator = "tests/golden/plans/team-value-2.0.plan";
    assert_fails(&plain(&[allocator]), 2, &["allocator"]);
}

#[test]
fn wrong_uses_of_a_team_are_refused() {
    let board = ["firmware", BUNDLE, "--board", "cortex-m4f"];
    let asked = |more: &[&str]| output(&[&board, more].concat());
    let alone = asked(&["--damage", "2000"]);
    assert_fails(&alone, 2, &["required arguments"]);
    assert!(stderr(&alone).contains("--team"), "{}", stderr(&alone));
    assert_fails(&asked(&["--team", "--damage", "1"]), 2, &["--damage"]);
    assert_fails(&asked(&["--team", "--table", "docs/evidence/firmware.md"]), 2, &["--table"]);
}
