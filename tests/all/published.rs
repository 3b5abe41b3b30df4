//! The preset `paper` from training to deployment, in small.

use crate::support::{self, assert_fails, json, output};

/// A run of seconds.
const SMALL: [&str; 24] = [
    "--set",
    "environment.instances=2",
    "--set",
    "environment.constants.episode_limit=40",
    "--set",
    "low_level.width=16",
    "--set",
    "low_level.base=8",
    "--set",
    "low_level.hypernetwork_width=16",
    "--set",
    "low_level.mixing=8",
    "--set",
    "allocation.width=16",
    "--set",
    "allocation.proposals=4",
    "--set",
    "learning.windows=4",
    "--set",
    "run.evaluate_every=300",
    "--set",
    "run.evaluate_episodes=8",
    "--set",
    "run.final_episodes=8",
];

fn train(method: &str, folder: &str, more: &[&str]) {
    let mut arguments = vec!["train", method, "--preset", "paper", "--out", folder, "-q"];
    arguments.extend(SMALL);
    arguments.extend(["--steps", "600"]);
    arguments.extend(more);
    let output = output(&arguments);
    assert!(output.status.success(), "{}", support::stderr(&output));
}

#[test]
fn a_published_run_becomes_a_bundle_whose_allocator_proposes() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    train("alma", &run, &[]);
    let exported = json(&["export", &run, "--out", &bundle, "--episodes", "10", "--json"]);
    assert_eq!(exported["sha256"].as_str().map(str::len), Some(64));
    let facts = json(&["inspect", &bundle, "--json"]);
    assert_eq!(facts["network"]["allocator"], "proposals");
    let verified = json(&["verify", &bundle, "--inputs", "32", "--json"]);
    let engines = verified["engines"].as_array().expect("engines");
    assert!(engines.iter().all(|engine| engine["action_mismatches"] == 0), "{verified}");

    // The most probable allocation needs no draws, so that trainer and plan decide alike.
    let greedy =
        |subject: &str| json(&["eval", subject, "--episodes", "20", "--proposals", "1", "--json"]);
    let (trained, deployed) = (greedy(&run), greedy(&bundle));
    for key in ["success", "return_mean", "length_mean"] {
        assert_eq!(trained[key], deployed[key], "{key}");
    }
    assert_eq!(deployed["allocation"], "learned");
    let played = json(&["run", &bundle, "--in-process", "--episodes", "2", "--json"]);
    assert_eq!(played["episodes"], 2);
}

#[test]
fn flat_runs_and_rules_learn_by_the_published_algorithm_too() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (flat, heuristic) = (path("flat"), path("heuristic"));
    train("flat", &flat, &[]);
    train("alma", &heuristic, &["--allocation", "heuristic"]);
    for (run, allocation) in [(&flat, "none"), (&heuristic, "heuristic")] {
        let played = json(&["eval", run, "--episodes", "5", "--json"]);
        assert_eq!(played["episodes"], 5);
        let curve = std::fs::read_to_string(format!("{run}/curve.json")).expect("a curve");
        assert!(curve.contains(&format!("\"allocation\":\"{allocation}\"")), "{curve}");
    }
    let refused = output(&["export", &flat, "--out", &path("bundle")]);
    assert_fails(&refused, 2, &["subtask"]);
    let mixer = ["train", "alma", "--preset", "paper", "--mixer", "sum", "--out", &path("sum")];
    assert_fails(&output(&mixer), 2, &["`alma`", "drop `--mixer`"]);
    let preset = ["train", "alma", "--preset", "slow", "--out", &path("slow")];
    assert_fails(&output(&preset), 2, &["fast", "paper"]);
}

#[test]
fn a_coach_is_trained_and_measured_but_not_deployed() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let run = path("run");
    train("copa", &run, &[]);
    let played = json(&["eval", &run, "--episodes", "5", "--json"]);
    assert_eq!(played["episodes"], 5);
    let refused = output(&["export", &run, "--out", &path("bundle")]);
    assert_fails(&refused, 2, &["coach"]);
}

#[test]
fn a_coach_learns_under_the_conditions_of_the_preset_fast() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let run = path("run");
    let begin = ["train", "copa", "--steps", "300", "--out", &run, "--quiet"];
    let begun = output(&[&begin[..], &SMALL, &["--set", "learning.updates=1"]].concat());
    assert!(begun.status.success(), "{}", support::stderr(&begun));
    let text = std::fs::read_to_string(format!("{run}/train.toml")).expect("a configuration");
    for line in ["learner = \"windows\"", "enabled = true", "shaping = 0.5", "updates = 1"] {
        assert!(text.contains(line), "no `{line}` in {text}");
    }
    let records = path("records.toml");
    std::fs::write(&records, "[returns]\nsteps = 3\n").expect("a file");
    let wrong = ["train", "copa", "--config", &records, "--out", &path("wrong")];
    assert_fails(&output(&wrong), 2, &[&records, "line 2", "`returns.steps`"]);
}
