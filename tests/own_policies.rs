//! Agents with policies of their own, from training to a team that acts by them.

mod support;

use serde_json::Value;
use support::{TestDomain, assert_fails, json, output};

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
    assert_eq!(facts["network"]["agent"], "policy");
    let domain = TestDomain::new("ownpolicies");
    let play = |more: &[&str]| {
        let run = ["run", &bundle, "--json", "--seed", "5", "--episodes", "5"];
        json(&[&run[..], more].concat())
    };
    let (one, several) = (play(&["--in-process"]), play(&["--domain", &domain.id]));
    assert_eq!(one["return_mean"], several["return_mean"]);
    assert!(one["decisions"].as_u64() > Some(0), "{one}");
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
}
