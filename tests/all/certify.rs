//! `sortie certify`: all decisions come to one hash, and what differs or cannot be run is named.

use std::fs;

use serde_json::Value;

use crate::support::{BUNDLE, assert_fails, json, output, sortie, stderr};

const TABLE: &str = "docs/evidence/certified.md";

/// The hash that the table has of a bundle's exact plans.
fn recorded(bundle: &str) -> String {
    let table = fs::read_to_string(TABLE).expect("the table");
    let row = table.lines().find(|line| line.starts_with(&format!("| {bundle} | exact |")));
    let row = row.unwrap_or_else(|| panic!("{bundle} is not in the table"));
    row.trim_matches([' ', '|']).rsplit(' ').next().expect("a hash").to_owned()
}

#[test]
fn every_shipped_bundle_is_in_the_table() {
    for bundle in fs::read_dir("models").expect("the bundles") {
        let bundle = bundle.expect("a bundle").file_name().into_string().expect("text");
        assert_eq!(recorded(&bundle).len(), 16, "{bundle}");
    }
}

#[test]
fn every_build_of_the_kernels_has_the_recorded_hash() {
    // One network, several, and one that goes from milestone to milestone.
    for bundle in ["group-matching", "rover-tower-8", "crafting-iron"] {
        let path = format!("models/{bundle}");
        let found =
            json(&["certify", &path, "--on", "host", "--table", TABLE, "--json", "--quiet"]);
        assert_eq!(found["hash"], recorded(bundle), "{bundle}");
        let targets = found["targets"].as_array().expect("targets");
        assert!(targets.iter().all(|target| target["hash"] == found["hash"]), "{targets:?}");
        let builds = |key: &str| found[key].to_string().matches("this machine").count();
        let expected = builds("targets") + builds("not_run");
        assert!(expected > 1 || !cfg!(target_arch = "x86_64"), "portable kernels too: {found}");
        let engines: Vec<&Value> = found["engines"].as_array().expect("engines").iter().collect();
        if bundle == "crafting-iron" {
            assert!(engines.is_empty() && found["unjudged"].is_string(), "{found}");
            continue;
        }
        for name in ["plan", "tract"] {
            let engine = engines.iter().find(|engine| engine["engine"] == name).expect(name);
            assert!(engine["max_distance"].as_f64().is_some_and(|it| it <= 16.0), "{engine}");
        }
    }
}

#[test]
fn another_hash_than_expected_fails_and_names_the_target() {
    let hash = recorded("save-the-city");
    let asked = |hash: &str| output(&["certify", BUNDLE, "--on", "host", "--expect", hash]);
    assert!(asked(&hash).status.success());
    let other = asked("0123456789abcdef");
    assert_fails(&other, 1, &["this machine", "kernels", &hash, "0123456789abcdef is expected"]);
    assert!(String::from_utf8_lossy(&other.stdout).contains("OTHER"), "{other:?}");
    assert_fails(&asked("12"), 2, &["16 hexadecimal digits"]);
}

#[test]
fn another_hash_than_in_the_table_fails_and_can_be_written() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (table, page) = (folder.path().join("table.md"), folder.path().join("page.md"));
    let (table, page) = (table.display().to_string(), page.display().to_string());
    let bundle = "models/group-matching";
    let asked = |more: &[&str]| {
        output(
            &[&["certify", bundle, "--on", "host", "--table", &table, "--page", &page], more]
                .concat(),
        )
    };
    assert_fails(&asked(&[]), 66, &["table.md"]);
    assert!(asked(&["--write"]).status.success());
    let written = fs::read_to_string(&table).expect("the table");
    let hash = recorded("group-matching");
    assert!(
        written.contains(&hash) && fs::read_to_string(&page).expect("the page").contains(&hash)
    );
    fs::write(&table, written.replace(&hash, "0123456789abcdef")).expect("a file");
    assert_fails(&asked(&[]), 1, &["table.md", &hash, "0123456789abcdef"]);
    let fewer = asked(&["--decisions", "3"]);
    assert!(fewer.status.success() && stderr(&fewer).contains("nothing is recorded"), "{fewer:?}");
}

#[test]
fn the_program_of_pages_decides_alike() {
    let on_wasm = |subject: &str| {
        let found = json(&["certify", subject, "--on", "wasm", "--json", "--quiet"]);
        let targets = found["targets"].as_array().expect("a list");
        let target = targets.iter().find(|it| it["target"] == "wasm").expect("its hash").clone();
        (found["hash"].clone(), target["hash"].clone())
    };
    for subject in ["models/group-matching", "models/rover-tower-8"] {
        let (here, there) = on_wasm(subject);
        assert_eq!(here, there, "{subject}");
    }
    let options = output(&["certify", "models/crafting-iron", "--on", "wasm"]);
    assert_fails(&options, 2, &["wasm", "run no options"]);
}

#[test]
fn a_board_that_cannot_be_run_is_named_and_fails_where_it_is_asked_for() {
    let empty = tempfile::tempdir().expect("a temporary folder");
    let asked = |more: &[&str]| {
        let mut command = sortie(&[&["certify", "models/group-matching"], more].concat());
        command.env("PATH", empty.path()).output().expect("the command line starts")
    };
    let usual = asked(&[]);
    assert!(usual.status.success(), "{}", stderr(&usual));
    let said = String::from_utf8_lossy(&usual.stdout).into_owned();
    for board in ["cortex-m4f", "rv32imc", "rv32imafc", "aarch64"] {
        assert!(said.contains(&format!("Not run: {board}: `cargo`")), "{said}");
    }
    assert!(said.contains("Not run: wasm: `node` cannot be started"), "{said}");
    assert_fails(&asked(&["--on", "cortex-m0"]), 69, &["cortex-m0", "cargo"]);
    assert_fails(&asked(&["--on", "wasm"]), 69, &["wasm", "node"]);
}

#[test]
fn recorded_observations_are_decided_on_and_belong_to_a_bundle() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let seen = folder.path().join("seen.bin").display().to_string();
    assert!(output(&["eval", BUNDLE, "--episodes", "1", "--dump", &seen]).status.success());
    let host = ["--on", "host", "--observations", &seen];
    let found = json(&[&["certify", BUNDLE, "--json", "--quiet"], &host[..]].concat());
    assert_eq!(found["observations"], format!("observations of {seen}"));
    assert_ne!(found["hash"], recorded("save-the-city"));
    assert!(found["decisions"].as_u64().is_some_and(|count| count > 0), "{found}");
    let asked = |subject: &str| output(&[&["certify", subject], &host[..]].concat());
    assert_fails(&asked("examples/embed_c/cart.plan"), 2, &["belong to a bundle"]);
}
