//! An agent that goes from milestone to milestone, by the verbs that take a bundle.

use std::fs;

use serde_json::Value;

use crate::support::{assert_fails, json, output};

const BUNDLE: &str = "models/crafting-iron";

#[test]
fn it_acts_in_processes_and_in_one_alike() {
    let run = |more: &[&str]| {
        json(&[&["run", BUNDLE, "--episodes", "3", "--seed", "6", "--json"], more].concat())
    };
    let [apart, together] = [run(&[]), run(&["--in-process"])];
    for report in [&apart, &together] {
        assert_eq!(report["success"], 1.0, "{report}");
    }
    assert_eq!(apart["decisions"], together["decisions"]);
    assert_eq!(apart["return_mean"], together["return_mean"]);
}

#[test]
fn its_page_shows_what_it_goes_for_and_believes_beside_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("page.html").display().to_string();
    let report = json(&["view", BUNDLE, "--json", "-o", &file, "--episode", "2"]);
    let text = fs::read_to_string(&file).unwrap();
    let (_, rest) = text.split_once("id=\"episode\">").unwrap();
    let data: Value = serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap();
    let (states, steps) = (data["states"].as_array().unwrap(), data["steps"].as_array().unwrap());
    assert_eq!(
        (report["steps"].as_u64(), states.len()),
        (Some(steps.len() as u64), steps.len() + 1)
    );
    assert_eq!(data["milestones"][10], "iron");
    assert_eq!(states[0]["cells"].as_array().unwrap().len(), 144);
    assert_eq!(data["field"]["to"], serde_json::json!([11.5, 11.5]));
    let (mut agreeing, mut bits) = (0, 0);
    for (state, step) in states.iter().zip(steps) {
        let thought = &state["thoughts"][0]["option"];
        let (mask, truth) =
            (thought["mask"].as_u64().unwrap(), state["affordances"].as_u64().unwrap());
        agreeing += 11 - (mask ^ truth).count_ones();
        bits += 11;
        assert_eq!(thought["likelihoods"].as_array().unwrap().len(), 11);
        assert!(
            thought["goal"].as_u64().unwrap() < 11 && step["actions"][0].as_u64().unwrap() < 11
        );
    }
    // Most of what it believes is so.
    assert!(agreeing * 10 > bits * 7, "{agreeing} of {bits}");
    assert!(states.last().unwrap().get("thoughts").is_none());
    let events = data["events"].as_array().unwrap();
    assert!(events.len() > 5 && events[0]["text"] == "log", "{events:?}");
}

#[test]
fn what_it_cannot_do_is_refused() {
    let fails = |arguments: &[&str], code, words: &[&str]| {
        assert_fails(&output(arguments), code, words);
    };
    fails(
        &["run", BUNDLE, "--allocation", "heuristic", "--episodes", "1"],
        2,
        &["nobody allocates"],
    );
    fails(&["eval", BUNDLE, "--env", "treasure-rooms", "--episodes", "1"], 78, &["other features"]);
}
