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
