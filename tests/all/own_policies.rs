//! Agents with policies of their own, from training to a team that acts by them.

use std::fs;

use serde_json::{Value, json};

use crate::support::{self, TestDomain, assert_fails, json, output};

const SMALL: [&str; 15] = [
    "train",
    "maac",
    "-q",
    "--env",
    "particle/rover-tower-4",
    "--steps",
    "6000",
    "--set",
    "replay.first=1000",
    "--set",
    "run.evaluate_episodes=20",
    "--set",
    "run.final_episodes=20",
    "--set",
    "run.evaluate_every=6000",
];

/// Trains for some steps, and exports what was learned: run and bundle.
fn deployed(place: &tempfile::TempDir, settings: &[&str]) -> [String; 2] {
    let [run, bundle] = ["run", "bundle"].map(|name| place.path().join(name).display().to_string());
    let settings = settings.iter().flat_map(|setting| ["--set", setting]);
    let arguments: Vec<&str> = SMALL.into_iter().chain(["--out", &run]).chain(settings).collect();
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    let exported = json(&["export", &run, "--out", &bundle, "--episodes", "20", "--json"]);
    assert_eq!(exported["bundle"], bundle.as_str());
    [run, bundle]
}

/// The bundle's agents do what the run's do, in every engine.
fn assert_alike(run: &str, bundle: &str) -> Value {
    let against = ["--against", "tract,golden"];
    let verify = ["verify", bundle, "--inputs", "64", "--json"];
    let verified = json(&[&verify[..], &against].concat());
    for engine in verified["engines"].as_array().expect("engines") {
        assert_eq!(engine["action_mismatches"], 0, "{engine}");
        assert!(engine["inputs"].as_u64() >= Some(64), "{engine}");
    }
    let evaluate = |subject: &str| json(&["eval", subject, "--episodes", "60", "--json"]);
    let [learned, deployed] = [evaluate(run), evaluate(bundle)];
    for figure in ["return_mean", "length_mean", "near", "by_team"] {
        assert!(!learned[figure].is_null(), "{figure}: {learned}");
        assert_eq!(deployed[figure], learned[figure], "{figure}");
    }
    learned
}

#[test]
fn agents_of_a_role_share_a_network_and_know_their_number() {
    let place = tempfile::tempdir().expect("a folder");
    let scaled = ["network.input_scale=3.0", "network.policy_width=24"];
    let [run, bundle] = deployed(&place, &scaled);
    assert_alike(&run, &bundle);
    let facts = json(&["inspect", &bundle, "--json"]);
    let network = &facts["network"];
    assert_eq!(network["agent"], "policy");
    assert_eq!(network["graph_of"], json!([0, 0, 1, 1]));
    let [rover, tower] = [&network["graphs"][0], &network["graphs"][1]];
    assert_eq!((&rover["name"], &tower["name"]), (&json!("rover"), &json!("tower")));
    assert!(tower["features"].as_u64() < rover["features"].as_u64());
    // A decision costs three layers of the role's own sizes, which of two agents it is, and what lies between. The numbers of
    // rovers are the places of a table, in which theirs is looked up.
    for graph in [rover, tower] {
        let name = graph["name"].as_str().expect("a name");
        let plan = json(&["inspect", &format!("{bundle}/agent-{name}.plan"), "--json"]);
        let size = |what: &str| graph[what].as_u64().expect("a size");
        let layers = 24 * (size("features") + 24 + size("actions"));
        let own = if name == "rover" { 0 } else { 2 };
        assert_eq!(plan["macs"], layers + 24 * (own + 3), "{name}");
    }
    let domain = TestDomain::new("ownpolicies");
    let play = |more: &[&str]| {
        let run = ["run", &bundle, "--json", "--seed", "5", "--episodes", "5"];
        json(&[&run[..], more].concat())
    };
    let (one, several) = (play(&["--in-process"]), play(&["--domain", &domain.id]));
    assert_eq!(one["return_mean"], several["return_mean"]);
    assert!(one["decisions"].as_u64() > Some(0), "{one}");
    let again = place.path().join("again").display().to_string();
    let compiled = json(&["compile", &bundle, "-o", &again, "--json"]);
    assert_eq!(compiled["sha256"], facts["sha256"]);
    let larger = ["run", &bundle, "--in-process", "--env", "particle/rover-tower-6"];
    assert_fails(&output(&larger), 78, &["trained for other features or actions"]);
    let out = place.path().join("other").display().to_string();
    let other = ["export", &run, "--env", "particle/navigation-3", "--out", &out];
    assert_fails(&output(&other), 78, &["with other features or actions"]);
}

#[test]
fn agents_with_networks_of_their_own_see_what_batches_had_on_average() {
    let place = tempfile::tempdir().expect("a folder");
    let own = ["network.shared=false", "network.normalised=true", "network.policy_width=16"];
    let [run, bundle] = deployed(&place, &own);
    assert_alike(&run, &bundle);
    let facts = json(&["inspect", &bundle, "--json"]);
    assert_eq!(facts["network"]["graph_of"], json!([0, 1, 2, 3]));
    assert_eq!(facts["agents"]["3"]["inputs"].as_array().map(Vec::len), Some(1), "{facts}");
}

#[test]
fn a_graph_that_is_missing_or_of_other_sizes_is_named() {
    let place = tempfile::tempdir().expect("a folder");
    let [_, bundle] = deployed(&place, &["network.policy_width=8"]);
    let manifest = format!("{bundle}/bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the bundle's manifest");
    let refused = |from: &str, to: &str, exit, words: &[&str]| {
        assert!(text.contains(from), "{text}");
        fs::write(&manifest, text.replacen(from, to, 1)).expect("another manifest");
        assert_fails(&output(&["run", &bundle, "--in-process"]), exit, words);
    };
    refused("    1,\n    1,\n]", "    1,\n    1,\n    1,\n]", 78, &["4 agents", "of 5"]);
    let known = "name = \"tower\"\nfeatures = ";
    refused(known, "name = \"tower\"\nfeatures = 1 # ", 78, &["the number of features"]);
    refused(known, "name = \"tower\"\nfeatures = 9", 65, &["`tower`", "features, a row has"]);
    fs::write(&manifest, &text).expect("the manifest");
    fs::remove_file(format!("{bundle}/agent-tower.onnx")).expect("a graph");
    let gone = output(&["verify", &bundle]);
    assert_fails(&gone, 66, &["agent-tower.onnx` is missing"]);
}

#[test]
fn agents_that_look_up_what_to_do_are_deployed() {
    let place = tempfile::tempdir().expect("a folder");
    let [run, bundle] = ["run", "bundle"].map(|name| place.path().join(name).display().to_string());
    let train = ["train", "ma-exp", "-q", "--env", "gridworld/task3-2", "--steps", "60000"];
    let short = ["--set", "run.evaluate_every=60000", "--set", "run.final_episodes=20"];
    let trained = output(&[&train[..], &short, &["--out", &run]].concat());
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    json(&["export", &run, "--out", &bundle, "--episodes", "20", "--json"]);
    let against = ["--against", "tract,golden"];
    let verified = json(&[&["verify", &bundle, "--inputs", "64", "--json"][..], &against].concat());
    for engine in verified["engines"].as_array().expect("engines") {
        assert_eq!(engine["action_mismatches"], 0, "{engine}");
    }
    let evaluate = |subject: &str| json(&["eval", subject, "--episodes", "60", "--json"]);
    let [learned, deployed] = [evaluate(&run), evaluate(&bundle)];
    for figure in ["return_mean", "length_mean", "treasures"] {
        assert!(!learned[figure].is_null(), "{figure}: {learned}");
        assert_eq!(deployed[figure], learned[figure], "{figure}");
    }
    let play = ["run", &bundle, "--json", "--in-process", "--episodes", "5"];
    assert!(json(&play)["decisions"].as_u64() > Some(0));
}

#[test]
fn the_shipped_team_of_the_gridworld_acts_in_processes_in_one_and_in_training_alike() {
    const SHIPPED: &str = "models/gridworld";
    let run = |more: &[&str]| {
        let play = ["run", SHIPPED, "--rate", "0", "--episodes", "6", "--seed", "5", "--json"];
        json(&[&play[..], more].concat())
    };
    let [apart, together] = [run(&[]), run(&["--in-process"])];
    for report in [&apart, &together] {
        assert_eq!(
            (&report["success"], &report["metrics"]["treasures"]),
            (&1.0.into(), &2.0.into())
        );
        assert_eq!(report["fallbacks"], 0, "{report}");
    }
    assert_eq!(apart["decisions"], together["decisions"]);
    assert_eq!(apart["return_mean"], together["return_mean"]);
    // The run that its folder describes learns the same team again: of tables, whatever multiplies matrices.
    let place = tempfile::tempdir().expect("a folder");
    let run = place.path().join("run").display().to_string();
    let train = ["train", "ma-exp", "--config", "models/gridworld/train.toml", "--seed", "106"];
    let here = ["--set", "run.products=widest", "--threads", "1", "--out", &run, "-q"];
    let trained = output(&[&train[..], &here].concat());
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    let evaluate = |subject: &str| json(&["eval", subject, "--episodes", "60", "--json"]);
    let [learned, deployed] = [evaluate(&run), evaluate(SHIPPED)];
    for figure in ["return_mean", "length_mean", "treasures"] {
        assert_eq!(deployed[figure], learned[figure], "{figure}");
    }
}
