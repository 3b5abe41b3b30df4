//! What the project depends on: licences that permit what its own permits, and no second version of a crate unseen.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

/// Licences of which one in each choice must do.
const PERMISSIVE: [&str; 10] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BlueOak-1.0.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "ISC",
    "MIT",
    "Unicode-3.0",
    "Zlib",
];
/// Crates with another licence: tests use them, no program holds them.
const FOR_TESTS_ALONE: [&str; 1] = ["cbindgen"];
/// Crates of which there are several versions: each costs building time, and others ask for the older ones.
const SEVERAL: [&str; 11] = [
    "embedded-io",
    "hashbrown",
    "itertools",
    "ndarray",
    "nom",
    "shlex",
    "smallvec",
    "syn",
    "toml",
    "toml_datetime",
    "winnow",
];

/// The packages of this machine's builds.
fn packages() -> Vec<Value> {
    let version = Command::new(env!("CARGO")).arg("-vV").output().expect("cargo");
    let version = String::from_utf8(version.stdout).expect("text");
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("a host");
    let asked = ["metadata", "--format-version=1", "--locked", "--filter-platform", host];
    let metadata = Command::new(env!("CARGO")).args(asked).output().expect("cargo");
    assert!(metadata.status.success(), "{}", String::from_utf8_lossy(&metadata.stderr));
    let metadata: Value = serde_json::from_slice(&metadata.stdout).expect("JSON");
    metadata["packages"].as_array().expect("packages").clone()
}

/// Whether a licence expression can be met by permissive ones: by one of each choice, and by all that are joined.
fn permits(expression: &str) -> bool {
    let expression = expression.replace(['(', ')'], "").replace('/', " OR ");
    let choice = |part: &str| part.split(" OR ").any(|name| PERMISSIVE.contains(&name.trim()));
    expression.split(" AND ").all(choice)
}

#[test]
fn every_licence_permits_what_ours_does() {
    let packages = packages();
    assert!(packages.len() > 100, "{} packages", packages.len());
    for package in packages {
        let name = package["name"].as_str().expect("a name");
        let licence = package["license"].as_str().unwrap_or_default();
        let known = permits(licence) || FOR_TESTS_ALONE.contains(&name);
        assert!(known, "{name} has the licence `{licence}`");
    }
}

#[test]
fn licences_are_read_as_choices_and_as_conditions() {
    assert!(permits("MIT OR GPL-3.0"));
    assert!(permits("(MIT OR Apache-2.0) AND Unicode-3.0"));
    assert!(permits("Unlicense/MIT"));
    assert!(!permits("MIT AND GPL-3.0"));
    assert!(!permits("MPL-2.0"));
    assert!(!permits(""));
}

#[test]
fn no_crate_comes_in_a_second_version_unseen() {
    let mut versions = BTreeMap::<String, BTreeSet<String>>::new();
    for package in packages() {
        let text = |key: &str| package[key].as_str().expect("text").to_owned();
        versions.entry(text("name")).or_default().insert(text("version"));
    }
    let several = versions.iter().filter(|(_, versions)| versions.len() > 1);
    let several: Vec<&str> = several.map(|(name, _)| name.as_str()).collect();
    assert_eq!(several, SEVERAL, "take the same version, or add it to the list");
}
