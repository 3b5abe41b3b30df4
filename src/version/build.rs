//! Tells the program which commit it is built from, and how. Without git or a repository it says the version alone.

use std::env;
use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    watch_head();
    let package = env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let version = match git(&["log", "-1", "--format=%h %cs"]) {
        Some(commit) => format!("{package} ({commit})"),
        None => package,
    };
    let name = |variable| env::var(variable).unwrap_or_default();
    println!("cargo:rustc-env=SORTIE_VERSION={version}");
    println!("cargo:rustc-env=SORTIE_BUILD={}, {}", name("PROFILE"), name("TARGET"));
}

/// Builds anew where another commit is checked out, and for no other reason: the files that say which one it is.
fn watch_head() {
    let branch = git(&["symbolic-ref", "--quiet", "HEAD"]);
    for name in ["HEAD".to_owned()].into_iter().chain(branch) {
        let path = git(&["rev-parse", "--git-path", &name]);
        // A path that is missing would count as changed in every build.
        if let Some(path) = path.filter(|path| Path::new(path).exists()) {
            println!("cargo:rerun-if-changed={path}");
        }
    }
}

/// What git prints, if it is there and the workspace is the top of its repository: inside another one it is none of its commits.
fn git(arguments: &[&str]) -> Option<String> {
    if !Path::new("../../.git").exists() {
        return None;
    }
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let text = text.trim();
    (output.status.success() && !text.is_empty()).then(|| text.to_owned())
}
