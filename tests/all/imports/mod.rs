//! Imports run one way inside every crate.

mod circles;
mod environments;
mod modules;
mod tokens;

use std::fs;
use std::path::{Path, PathBuf};

use circles::circles;
use modules::Crate;

#[test]
fn imports_run_one_way_inside_every_crate() {
    let circles = crates().into_iter().flat_map(|(name, root)| {
        let circles = circles(Crate::read(&root).imports());
        circles.into_iter().map(move |circle| format!("{name}: {circle}"))
    });
    let wrong: String = circles.collect();
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn a_circle_is_found_through_folders_re_exports_and_paths_in_code() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let file = folder.path().join(name);
        fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
        fs::write(file, text).expect("a file");
    };
    write("lib.rs", "mod a;\nmod b;\nmod c;\npub use a::{Deep, second as renamed};\n");
    write("a/mod.rs", "mod deep;\nmod low;\npub use deep::*;\npub fn second() {}\n");
    write("a/deep.rs", "//! See [`crate::c`].\nuse super::low::Low;\npub struct Deep(Low);\n");
    write("a/low.rs", "pub struct Low;\nfn low() { crate::b::b(\"crate::c::c\") }\n");
    write("b.rs", "use crate::{Deep,\n    c::C};\npub fn b(_: &str) {}\n");
    write("c.rs", "pub struct C;\n#[cfg(test)]\nmod tests {\n    use crate::renamed;\n}\n");

    let found = circles(Crate::read(&folder.path().join("lib.rs")).imports());
    let found: Vec<String> = found.iter().map(ToString::to_string).collect();
    let expected = format!(
        "circle of 2 in `crate`: a, b\n  a imports b\n    {0}/a/low.rs:2: crate::b::b\n  \
         b imports a\n    {0}/b.rs:1: crate::Deep\n",
        folder.path().display()
    );
    assert_eq!(found, [expected]);
}

/// Every crate of the workspace by its folder, with its root file.
fn crates() -> Vec<(String, PathBuf)> {
    let manifest = fs::read_to_string("Cargo.toml").expect("the test runs in the project's folder");
    let manifest: toml::Table = manifest.parse().expect("the manifest is TOML");
    let members = manifest["workspace"]["members"].as_array().expect("a list of members");
    let folders = members.iter().filter_map(|member| member.as_str());
    folders.map(|folder| (folder.to_owned(), root_file(Path::new(folder)))).collect()
}

fn root_file(folder: &Path) -> PathBuf {
    ["src/lib.rs", "lib.rs", "src/main.rs", "main.rs"]
        .iter()
        .map(|file| folder.join(file))
        .find(|file| file.exists())
        .unwrap_or_else(|| panic!("{} has neither lib.rs nor main.rs", folder.display()))
}
