//! `sortie eval` and `sortie bench`: what scripts read from them.

use crate::support::{BUNDLE, assert_fails, json, output};

#[test]
fn failed_episodes_have_a_cause_each_and_a_planner_says_what_it_is() {
    let report = json(&["eval", "scripted", "--episodes", "40", "--plan", "2", "--json"]);
    let failures = report["failures"].as_object().expect("causes by name");
    let failed: u64 = failures.values().filter_map(serde_json::Value::as_u64).sum();
    let success = report["success"].as_f64().expect("a share");
    assert_eq!(failed as f64, (40.0 * (1.0 - success)).round());
    assert_eq!(report["planner"]["candidates"], 2);
    assert_eq!(report["planner"]["uses_simulator"], true);
}

#[test]
fn an_evaluation_without_a_planner_does_not_mention_one() {
    let report = json(&["eval", "scripted", "--episodes", "5", "--json"]);
    assert!(report.get("planner").is_none());
    assert_eq!(report["failures"].as_object().map(serde_json::Map::len), Some(7));
}

#[test]
fn a_python_without_torch_is_named() {
    for preset in ["fast", "paper", "paper-maac", "paper-ma-exp"] {
        let output = output(&["bench", "train", "--preset", preset, "--python", "no-such-python"]);
        assert_fails(&output, 69, &["no-such-python", "torch"]);
    }
}

#[test]
fn what_lost_agents_worked_on_is_never_left_to_them() {
    let found = json(&["bench", "losses", BUNDLE, "--lose=0,4", "--episodes=4", "--json"]);
    let handed_over = &found["handed_over"];
    assert!(handed_over["at_work"].as_u64() > Some(4), "{found}");
    assert_eq!([&handed_over["to_the_lost"], &handed_over["ticks_until_absent"]], [0, 4]);
    let [whole, without] =
        ["whole", "absent_from_the_start"].map(|when| found[when]["solved"].as_u64());
    assert!(whole > without, "{found}");
    let refused = output(&["bench", "losses", BUNDLE, "--team=2", "--lose=2", "--episodes=1"]);
    assert_fails(&refused, 2, &["agent 2 is not of a team of 2"]);
}
