//! Policies that are hard to take: each is taken, or refused in words that help.

use crate::support::{assert_fails, json, output, stderr};

fn file(name: &str, extension: &str) -> String {
    format!("tests/golden/onnx-hard/{name}.{extension}")
}

fn verified(name: &str, flags: &[&str]) {
    let (onnx, npz) = (file(name, "onnx"), file(name, "npz"));
    let arguments = [&["verify", &onnx, "--npz", &npz, "--json"], flags].concat();
    let report = json(&arguments);
    let first = &report["engines"][0];
    assert_eq!(first["name"], "plan against recorded", "{name}");
    assert!(first["max_distance"].as_f64().is_some_and(|distance| distance <= 16.0), "{first}");
}

#[test]
fn files_that_tract_or_names_make_hard_are_taken_as_they_are() {
    for name in [
        "synth_brax",
        "swish",
        "concat_expand_matmul",
        "gemm_f64",
        "onnxscript_function",
        "keras_mha",
        "keras_gru",
        "epymarl_rnn_5agents",
        "framestack",
        "hybrid_actions",
        "rllib_mask_loginf",
        "skl_regressor",
        "hidden_in_buffer",
        "ls2",
        "rlse_mask",
        "image_nhwc_bilinear",
        "gnn_scatter_dyn",
    ] {
        verified(name, &[]);
    }
    verified("urma", &["--size", "joints=12"]);
}

#[test]
fn one_question_asks_for_all_that_is_missing() {
    let flags = ["--output", "out_2", "--state", "in_0:add_out_3"];
    let asked = output(&["inspect", &file("jax_gru_cell", "onnx")]);
    assert_fails(&asked, 2, &[&flags.join(" ")]);
    verified("jax_gru_cell", &flags);
}

#[test]
fn both_heads_act_and_a_mask_of_floats_is_one() {
    let report = json(&["inspect", &file("hybrid_actions", "onnx"), "--json"]);
    let outputs = report["policy"]["outputs"].as_array().expect("outputs");
    let names: Vec<&str> = outputs.iter().filter_map(|output| output["name"].as_str()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
    let report = json(&["inspect", &file("rllib_mask_loginf", "onnx"), "--json"]);
    let inputs = report["policy"]["inputs"].as_array().expect("inputs");
    assert!(inputs.iter().any(|input| input["role"] == "available"), "{inputs:?}");
}

#[test]
fn what_would_be_forgotten_is_said() {
    let shown = output(&["inspect", &file("hidden_in_buffer", "onnx")]);
    assert!(shown.status.success() && stderr(&shown).contains("remembers nothing"));
    let report = json(&["inspect", &file("hidden_in_buffer", "onnx"), "--json"]);
    assert_eq!(report["remarks"].as_array().map(Vec::len), Some(1));
    let other = json(&["inspect", &file("framestack", "onnx"), "--json"]);
    assert!(other.get("remarks").is_none(), "{other}");
}

#[test]
fn what_was_recorded_in_16_bits_is_read() {
    let (onnx, npz) = (file("half_io", "onnx"), file("half_io", "npz"));
    assert_fails(&output(&["verify", &onnx, "--npz", &npz]), 1, &["plan against recorded"]);
}

#[test]
fn what_has_no_plan_is_refused_in_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("no.plan").display().to_string();
    let asked = output(&["compile", &file("iqn_random", "onnx"), "-o", &plan]);
    assert_fails(&asked, 2, &["RandomUniformLike"]);
}
