//! Exit codes as docs/reference/command-line.md lists them: one table of what is wrong with a file, by every verb that reads one.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::support::{BUNDLE, assert_fails, output};

const BROKEN: i32 = 65;
const MISSING: i32 = 66;
const INPUT_OR_OUTPUT: i32 = 74;
const OTHER_VERSION: i32 = 78;

/// Files of which each is wrong in its own way.
fn wrong_files(folder: &Path) {
    let no_text = [0xff, 0xfe, b'{', 0x80];
    fs::write(folder.join("garbage"), no_text).expect("a file");
    fs::create_dir(folder.join("empty")).expect("a folder");
    fs::create_dir(folder.join("run")).expect("a folder");
    for name in ["train.toml", "curve.json", "result.json"] {
        fs::write(folder.join("run").join(name), no_text).expect("a file");
    }
    let mut plan = fs::read(format!("{BUNDLE}/agent.plan")).expect("a plan");
    plan[8] = 99;
    fs::write(folder.join("newer.plan"), plan).expect("a file");
}

#[test]
fn every_wrong_file_has_the_code_that_is_documented() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    wrong_files(folder.path());
    let of_bundles: [&[&str]; 8] = [
        &["run", "@"],
        &["up", "@"],
        &["eval", "@"],
        &["verify", "@"],
        &["bench", "decision", "@"],
        &["firmware", "@", "--board", "cortex-m4f"],
        &["certify", "@", "--on", "host"],
        &["view", "@", "-o", "@.html"],
    ];
    let of_runs: [&[&str]; 3] =
        [&["eval", "@"], &["inspect", "@"], &["export", "@", "--out", "@.bundle"]];
    let of_files: [&[&str]; 5] = [
        &["inspect", "@"],
        &["serve", "@"],
        &["replay", "@"],
        &["train", "alma", "--config", "@"],
        &["bench", "policy", "@"],
    ];
    let of_plans: [&[&str]; 3] = [
        &["inspect", "@"],
        &["firmware", "@", "--board", "cortex-m4f"],
        &["certify", "@", "--on", "host"],
    ];
    let table: [(&str, i32, &[&[&str]]); 9] = [
        ("none", MISSING, &of_bundles),
        ("none", MISSING, &of_runs),
        ("none", MISSING, &of_files),
        ("empty", MISSING, &of_bundles),
        ("run", BROKEN, &of_runs),
        ("garbage", BROKEN, &of_files),
        // A folder of recorded episodes and a bundle are folders.
        ("empty", BROKEN, &[of_files[1], of_files[3], of_files[4]]),
        ("/dev/zero", BROKEN, &[of_files[1], of_files[2], of_files[3], of_files[4]]),
        ("newer.plan", OTHER_VERSION, &of_plans),
    ];
    for (file, code, verbs) in table {
        let path = folder.path().join(file).display().to_string();
        for verb in verbs {
            let verb: Vec<String> = verb.iter().map(|word| word.replace('@', &path)).collect();
            let words: Vec<&str> = verb.iter().map(String::as_str).collect();
            let failed = output(&words);
            assert_eq!(failed.status.code(), Some(code), "{words:?}: {failed:?}");
            assert_fails(&failed, code, &[&path]);
        }
    }
}

#[test]
fn what_the_system_refuses_is_input_or_output() {
    let refused = output(&["compile", &format!("{BUNDLE}/agent.onnx"), "-o", "/sys/agent.plan"]);
    assert_fails(&refused, INPUT_OR_OUTPUT, &["/sys/agent.plan", "Permission denied"]);
    // A limit of 512 bytes, of which the system tells by a signal.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -f 1; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_sortie"), "compile"]);
    shell.arg(format!("{BUNDLE}/agent.onnx")).arg("-o").arg(folder.path().join("agent.plan"));
    let limited = shell.output().expect("a shell");
    assert_fails(&limited, INPUT_OR_OUTPUT, &["File too large"]);
    assert_eq!(fs::read_dir(folder.path()).expect("the folder").count(), 0, "nothing stays");
}
