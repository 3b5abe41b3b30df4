//! `sortie replay`: recorded episodes, and files that are none.

use std::fs;

use crate::support::{assert_fails, json, output};

const EPISODE: &str = "tests/golden/save-the-city/043-3a-BFG-random-end-on-burn.json";

/// The recorded episode with one piece of its text replaced, in a file of its own.
fn edited(from: &str, to: &str) -> tempfile::NamedTempFile {
    let text = fs::read_to_string(format!("{}/{EPISODE}", env!("CARGO_MANIFEST_DIR")));
    let text = text.expect("the recorded episode");
    assert!(text.contains(from), "the episode has `{from}`");
    let file = tempfile::NamedTempFile::new().expect("a temporary file");
    fs::write(&file, text.replacen(from, to, 1)).expect("an edited copy");
    file
}

#[test]
fn every_environment_has_recorded_episodes() {
    let report = json(&["replay", "tests/golden/group-matching", "--json"]);
    assert_eq!(report["files"], 24);
    assert_eq!(report["mismatches"], serde_json::json!([]));
}

#[test]
fn recorded_episodes_replay_bit_for_bit() {
    let report = json(&["replay", EPISODE, "--json"]);
    assert_eq!(report["files"], 1);
    assert_eq!(report["steps"], 11);
    assert_eq!(report["mismatches"].as_array().map(Vec::len), Some(0));
}

#[test]
fn a_changed_reward_is_named_with_its_step() {
    let file = edited("\"reward\":-", "\"reward\":");
    let path = file.path().display().to_string();
    assert_fails(&output(&["replay", &path]), 1, &[&path, "step 0", "reward"]);
}

#[test]
fn a_missing_field_is_named() {
    let file = edited("\"initial\":", "\"initial_\":");
    let path = file.path().display().to_string();
    assert_fails(&output(&["replay", &path]), 65, &[&path, "initial"]);
}

#[test]
fn a_file_that_is_not_there_is_named() {
    assert_fails(&output(&["replay", "no/such/file.json"]), 66, &["no/such/file.json"]);
}

#[test]
fn text_that_is_no_json_is_refused() {
    let file = edited("{", "(");
    let path = file.path().display().to_string();
    assert_fails(&output(&["replay", &path]), 65, &[&path, "not JSON"]);
}

#[test]
fn recorded_evaluations_replay() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let place = folder.path().display().to_string();
    json(&["eval", "scripted", "--episodes", "5", "--episodes-out", &place, "--json"]);
    let files: Vec<String> = fs::read_dir(folder.path())
        .expect("the folder")
        .flatten()
        .map(|entry| entry.path().display().to_string())
        .collect();
    assert_eq!(files.len(), 5);
    let mut arguments = vec!["replay", "--json"];
    arguments.extend(files.iter().map(String::as_str));
    assert_eq!(json(&arguments)["files"], 5);
}

#[test]
fn what_the_front_page_replays_is_equal() {
    let page = fs::read_to_string("README.md").expect("the front page");
    let line = page.lines().find_map(|line| line.strip_prefix("sortie replay "));
    let folder = line.and_then(|line| line.split(' ').next()).expect("what is replayed");
    let told = json(&["replay", folder, "--json"]);
    assert!(told["files"].as_u64() > Some(1), "{told}");
    assert_eq!(told["mismatches"], serde_json::json!([]));
}
