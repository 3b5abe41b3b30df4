//! Twenty policies in the node patterns of their producers' exporters: each becomes a plan that gives what was recorded.

use std::fs;

use crate::support::{json, output, stderr};

const FOLDER: &str = "tests/golden/onnx-written";

#[test]
fn files_in_the_patterns_of_exporters_compile_and_agree() {
    let plans = tempfile::tempdir().expect("a folder");
    let entries = fs::read_dir(FOLDER).expect("the folder");
    let names = entries.map(|entry| entry.expect("a file").path());
    let files: Vec<_> =
        names.filter(|path| path.extension().is_some_and(|end| end == "onnx")).collect();
    assert_eq!(files.len(), 20);
    for file in files {
        let (onnx, npz) = (file.display().to_string(), file.with_extension("npz"));
        let plan = plans.path().join("policy.plan").display().to_string();
        let compiled = output(&["compile", &onnx, "-o", &plan]);
        assert!(compiled.status.success(), "{onnx}: {}", stderr(&compiled));
        let report = json(&["verify", &onnx, "--npz", &npz.display().to_string(), "--json"]);
        let first = &report["engines"][0];
        assert_eq!(first["name"], "plan against recorded", "{onnx}");
        assert_eq!(first["refusals_differ"], 0, "{onnx}: {first}");
    }
}

#[test]
fn a_robots_facts_are_kept_in_the_plan_and_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("robot.plan").display().to_string();
    let onnx = format!("{FOLDER}/mjlab_velocity.onnx");
    let compiled = output(&["compile", &onnx, "-o", &plan]);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    for file in [&plan, &onnx] {
        let robot = &json(&["inspect", file, "--json"])["robot"];
        assert_eq!(robot["joint_names"][3], "knee", "{file}: {robot}");
        assert_eq!(robot["action_scale"][0], 0.25);
        assert_eq!(robot["observation_names"][5], "command");
        assert_eq!(robot["normaliser"], "file");
    }
    let robot = &json(&["inspect", &format!("{FOLDER}/sb3_dqn.onnx"), "--json"])["robot"];
    assert_eq!(robot["normaliser"], "none");
}
