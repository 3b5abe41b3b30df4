//! `sortie verify`: which engines are compared, on what, and what is said where one is missing.

use serde_json::Value;

use crate::support::{BUNDLE, NO_ONNXRUNTIME, assert_fails, json, output, sortie, stderr};

const AGENT: &str = "tests/golden/onnx/agent_small.onnx";
const NO_PYTHON: &str = "/nowhere/bin/python3";

fn engines(report: &Value) -> &[Value] {
    report["engines"].as_array().expect("a list of engines")
}

fn family<'a>(engine: &'a Value, name: &str) -> &'a Value {
    let families = engine["families"].as_array().expect("a list of families");
    families.iter().find(|family| family["name"] == name).expect("the family was compared")
}

#[test]
fn every_family_is_reported_and_refusals_agree() {
    let report = json(&["verify", BUNDLE, "--inputs", "32", "--against", "tract,golden", "--json"]);
    let names: Vec<&str> = engines(&report).iter().filter_map(|e| e["name"].as_str()).collect();
    let want = [
        "plan against tract",
        "plan against double precision",
        "allocator plan against tract",
        "allocator plan against double precision",
        "plan against golden",
        "tract against golden",
        "allocator plan against golden",
        "allocator tract against golden",
    ];
    assert_eq!(names, want);
    for engine in engines(&report) {
        assert_eq!(engine["refusals_differ"], 0, "{engine}");
    }
    let agent = &engines(&report)[0];
    for name in ["NaN", "infinities", "no available action"] {
        let family = family(agent, name);
        assert_eq!(family["refused"], family["inputs"], "{family}");
    }
    for name in ["random", "nothing visible", "one entity", "denormals", "NaN behind the mask"] {
        assert_eq!(family(agent, name)["refused"], 0);
    }
    assert_eq!(report["not_compared"].as_array().map(Vec::len), Some(0));
}

#[test]
fn a_missing_onnxruntime_is_said_and_the_others_go_on() {
    // Whoever names none takes what there is: here a path without any interpreter.
    let mut command = sortie(&["verify", AGENT, "--inputs", "16", "--json"]);
    command.env_remove("ORT_DYLIB_PATH").env_remove("VIRTUAL_ENV").env("PATH", "/nowhere");
    let output = command.output().expect("the command line starts");
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("pip install onnxruntime"), "{}", stderr(&output));
    let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
    assert_eq!(report["not_compared"][0], "onnxruntime");
    let names: Vec<_> = engines(&report).iter().map(|engine| engine["name"].clone()).collect();
    assert_eq!(names, ["plan against tract", "plan against double precision"]);
}

#[test]
fn a_missing_onnxruntime_that_was_asked_for_ends_the_command() {
    let arguments = ["verify", AGENT, "--against", "onnxruntime", "--python", NO_PYTHON];
    assert_fails(&output(&arguments), 69, &[NO_PYTHON, "pip install onnxruntime"]);
}

#[test]
fn onnxruntime_is_a_judge_where_it_is_installed() {
    let report = json(&["verify", BUNDLE, "--inputs", "32", "--json"]);
    assert_ne!(report["not_compared"][0], "onnxruntime", "{NO_ONNXRUNTIME}");
    let name = |engine: &&Value| engine["name"].as_str().is_some_and(|n| n.contains("onnxruntime"));
    assert_eq!(engines(&report).iter().filter(name).count(), 4, "{report}");
}
