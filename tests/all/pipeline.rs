//! From training to deployment, in small: train, stop, resume, export, verify, evaluate, run.

use std::fs;
use std::path::Path;

use crate::support::{
    self, BUNDLE, Ending as _, SMALL, assert_fails, interrupt, json, output, sortie, wait_until,
};

fn train(folder: &str, steps: &str, threads: &str) {
    let mut arguments =
        vec!["train", "alma", "--out", folder, "--steps", steps, "--threads", threads, "-q"];
    arguments.extend(SMALL);
    let output = output(&arguments);
    assert!(output.status.success(), "{}", support::stderr(&output));
}

/// The weights and the optimiser of a run's newest checkpoint.
fn newest_tensors(folder: &str) -> Vec<u8> {
    let entries = fs::read_dir(Path::new(folder).join("checkpoints")).expect("checkpoints");
    let newest = entries.flatten().map(|entry| entry.path()).max().expect("a checkpoint");
    fs::read(newest.join("tensors.safetensors")).expect("its tensors")
}

#[test]
fn every_shipped_bundle_agrees_with_its_golden_answers() {
    let models = fs::read_dir("models").expect("the shipped bundles");
    let mut bundles: Vec<_> = models.flatten().map(|entry| entry.path()).collect();
    bundles.sort();
    assert_eq!(bundles.len(), 11, "{bundles:?}");
    for bundle in bundles {
        let bundle = bundle.display().to_string();
        // The team that the pages name passes the command that they name, with as many inputs as it takes by itself.
        let named = bundle == BUNDLE;
        let few: &[&str] = if named { &[] } else { &["--inputs", "32"] };
        let verified = json(&[&["verify", &bundle, "--json"], few].concat());
        let engines = verified["engines"].as_array().expect("engines");
        assert!(engines.iter().all(|engine| engine["action_mismatches"] == 0), "{verified}");
    }
}

#[test]
fn a_run_becomes_a_bundle_that_a_team_plays_with() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle, plan) = (path("run"), path("bundle"), path("agent.plan"));
    train(&run, "1500", "2");

    let exported = json(&["export", &run, "--out", &bundle, "--episodes", "10", "--json"]);
    assert_eq!(exported["sha256"].as_str().map(str::len), Some(64));
    let again = output(&["export", &run, "--out", &bundle, "--episodes", "20"]);
    assert_fails(&again, 2, &[&bundle, "exists"]);

    let few = ["--inputs", "64", "--against", "tract,golden", "--json"];
    let verified = json(&[&["verify", &bundle][..], &few].concat());
    assert_eq!(verified["engines"].as_array().map(Vec::len), Some(8), "{verified}");
    for (network, file) in [("agent", "agent.onnx"), ("team-value", "allocator_team_value.onnx")] {
        let onnx = format!("{bundle}/{file}");
        let compiled = json(&["compile", &onnx, "-o", &plan, "--n-max", "11", "--json"]);
        let inspected = json(&["inspect", &plan, "--json"]);
        assert_eq!(inspected["network"], network);
        for key in ["flash_bytes", "arena_bytes", "macs"] {
            assert_eq!(compiled[key], inspected[key], "{key}");
        }
        let alone = json(&["verify", &onnx, "--inputs", "64", "--against", "tract", "--json"]);
        assert_eq!(alone["engines"].as_array().map(Vec::len), Some(2), "{alone}");
    }
    let facts = json(&["inspect", &bundle, "--json"]);
    assert_eq!(facts["network"]["allocator"], "team-value");
    assert!(facts["allocator"]["parameters"].as_u64() > Some(0), "{facts}");

    let trained = json(&["eval", &run, "--episodes", "20", "--json"]);
    let deployed = json(&["eval", &bundle, "--episodes", "20", "--json"]);
    for key in ["success", "return_mean", "length_mean"] {
        assert_eq!(trained[key], deployed[key], "{key}");
    }
    assert_eq!(deployed["allocation"], "learned");
    let pairs = path("pairs");
    let exported = ["export", &run, "--out", &pairs, "--episodes", "10", "--team-max", "2", "-q"];
    assert!(output(&exported).status.success());
    assert_eq!(json(&["inspect", &pairs, "--json"])["limits"]["team_max"], 2);
    the_skip_is_told(&run, &bundle, true);
    allocators_are_swapped(&run, &bundle);
    let played = json(&["run", &bundle, "--in-process", "--episodes", "2", "--json"]);
    assert_eq!(played["episodes"], 2);
}

#[test]
fn a_run_without_a_skip_becomes_a_bundle_that_answers_as_it_does() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    let mut arguments = vec!["train", "alma", "--out", &run, "--steps", "1500", "-q"];
    arguments.extend(SMALL);
    arguments.extend(["--set", "network.skip=false", "--set", "allocator.network.skip=false"]);
    assert!(output(&arguments).status.success());
    let exported = ["export", &run, "--out", &bundle, "--episodes", "10", "-q"];
    assert!(output(&exported).status.success());

    // Golden observations and allocations hold what the trainer's own passes answered.
    let few = ["--inputs", "64", "--against", "tract,golden", "--json"];
    let verified = json(&[&["verify", &bundle][..], &few].concat());
    let engines = verified["engines"].as_array().expect("engines");
    assert!(engines.iter().all(|engine| engine["action_mismatches"] == 0), "{verified}");
    let trained = json(&["eval", &run, "--episodes", "20", "--json"]);
    let deployed = json(&["eval", &bundle, "--episodes", "20", "--json"]);
    assert_eq!(trained["return_mean"], deployed["return_mean"]);
    the_skip_is_told(&run, &bundle, false);
}

/// Whether attention is skipped stands in the card, in the run's configuration and in the plans.
fn the_skip_is_told(run: &str, bundle: &str, skip: bool) {
    let card = fs::read_to_string(format!("{bundle}/card.md")).expect("the card");
    let departure = "skips the attention in the networks of the agents and of the allocator";
    assert_eq!(card.contains(departure), skip, "{card}");
    let configuration = json(&["inspect", run, "--json"])["configuration"].clone();
    assert_eq!(configuration["network"]["skip"], skip);
    for plan in ["agent.plan", "allocator.plan"] {
        let facts = json(&["inspect", &format!("{bundle}/{plan}"), "--json"]);
        assert_eq!(facts.to_string().contains(", skip, relu"), skip, "{facts}");
    }
}

/// The allocator of a run and of its bundle are the same to any agents, and differ from rules.
fn allocators_are_swapped(run: &str, bundle: &str) {
    let play = |subject: &str, more: &[&str]| {
        let mut arguments = vec!["eval", subject, "--episodes", "40", "--json"];
        arguments.extend(more);
        json(&arguments)
    };
    let mean = |played: &serde_json::Value| played["return_mean"].as_f64().expect("a return");
    let by_rule = play("scripted", &[]);
    assert_eq!(by_rule["allocation"], "coordinated");
    for subject in ["scripted", run] {
        let by_run = play(subject, &["--allocator", run]);
        let by_bundle = play(subject, &["--allocator", bundle]);
        assert_eq!(by_bundle["allocator"], bundle);
        // An allocator that has hardly learned values teams nearly alike: now and then rounding decides.
        let apart = (mean(&by_run) - mean(&by_bundle)).abs();
        let may_be =
            if subject == run { 0.0 } else { (mean(&by_run) - mean(&by_rule)).abs() / 5.0 };
        assert!(apart <= may_be, "{subject}: {by_run} {by_bundle} {by_rule}");
    }
    assert_ne!(by_rule["return_mean"], play("scripted", &["--allocator", run])["return_mean"]);
    let larger = ["--env", "save-the-city/2-8a_2-8b", "--allocator"];
    let by_run = [&["eval", run, "--episodes", "5", "--json"], &larger[..], &[run]].concat();
    assert_eq!(json(&by_run)["env"], "save-the-city/2-8a_2-8b");
    let arguments = ["eval", run, larger[0], larger[1], larger[2], bundle];
    assert_fails(&output(&arguments), 78, &[bundle, "2-8a_2-8b"]);
    let arguments = ["eval", "scripted", "--allocation", "learned"];
    assert_fails(&output(&arguments), 2, &["scripted", "no learned allocator", "--allocation"]);
    let both = ["eval", BUNDLE, "--allocator", run, "--allocation", "random"];
    assert_eq!(output(&both).status.code(), Some(2));
}

#[test]
fn agents_that_see_more_than_their_subtask_are_not_exported() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    let mut arguments = vec!["train", "alma", "--out", &run, "--steps", "1000", "-q"];
    arguments.extend(SMALL);
    arguments.extend(["--set", "network.subtask=input"]);
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    assert_eq!(json(&["eval", &run, "--episodes", "5", "--json"])["episodes"], 5);
    assert_fails(&output(&["export", &run, "--out", &bundle]), 2, &["network.subtask", "mask"]);
}

#[test]
fn a_flat_run_is_evaluated_but_not_exported() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (run, bundle) = (path("run"), path("bundle"));
    let mut arguments =
        vec!["train", "flat", "--mixer", "qmix", "--out", &run, "--steps", "1000", "-q"];
    arguments.extend(SMALL);
    let trained = output(&arguments);
    assert!(trained.status.success(), "{}", support::stderr(&trained));
    assert_eq!(json(&["eval", &run, "--episodes", "5", "--json"])["allocation"], "none");
    let allocated = output(&["eval", &run, "--episodes", "5", "--allocation", "heuristic"]);
    assert_fails(&allocated, 2, &["no subtasks"]);
    assert_fails(&output(&["export", &run, "--out", &bundle]), 2, &["network.subtask"]);

    let contradiction = output(&["train", "flat", "--no-mask", "--out", &path("other")]);
    assert_fails(&contradiction, 2, &["`flat`", "drop `--no-mask`"]);
}

#[test]
fn the_same_seed_gives_the_same_weights_whatever_the_threads() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (one, two) = (path("one"), path("two"));
    train(&one, "1500", "1");
    train(&two, "1500", "2");
    assert_eq!(newest_tensors(&one), newest_tensors(&two));
}

#[test]
fn a_run_that_was_interrupted_goes_on_as_if_it_had_not_been() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| place.path().join(name).display().to_string();
    let (whole, parts) = (path("whole"), path("parts"));
    train(&whole, "4000", "2");

    let mut arguments = vec!["train", "alma", "--out", &parts, "--steps", "4000", "-q"];
    arguments.extend(SMALL);
    let mut child = sortie(&arguments).spawn().expect("the command line starts");
    wait_until("it has measured once", || {
        fs::metadata(Path::new(&parts).join("curve.json")).is_ok_and(|file| file.len() > 0)
    });
    interrupt(&child);
    assert_eq!(child.ended().code(), Some(130));
    let resumed = output(&["train", "alma", "--resume", &parts, "-q"]);
    assert!(resumed.status.success(), "{}", support::stderr(&resumed));
    assert_eq!(newest_tensors(&whole), newest_tensors(&parts));
}
