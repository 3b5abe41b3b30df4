//! Policies as the export code of others makes them: each becomes a plan that gives what was recorded.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{assert_fails, json, output};

const FOLDER: &str = "tests/golden/onnx-producers";

/// Files that say too little about themselves, and the flags that say it.
const FLAGS: [(&str, &[&str]); 3] = [
    ("torch_squashed", &["--output", "mean"]),
    ("mlagents_earlier_discrete", &["--output", "discrete_actions:likeliest"]),
    ("mlagents_earlier", &["--output", "continuous_actions:likeliest"]),
];

/// What is found in files where more than the observation goes in or something is to be chosen: wanted outputs, states.
const FOUND: [(&str, &str, &str); 15] = [
    ("rsl_rl_mlp", "actions continuous 12", ""),
    ("rsl_rl_gru_two_layers", "actions continuous 8", "h_in h_out 32"),
    ("rsl_rl_lstm", "actions continuous 8", "h_in h_out 24, c_in c_out 24"),
    (
        "sb3_recurrent_ppo_box.classic",
        "action continuous 3",
        "hidden next_hidden 16, cell next_cell 16",
    ),
    ("sb3_dqn_choice.dynamo", "action discrete 5", ""),
    ("sb3_dqn_cnn.dynamo", "q_values discrete 5", ""),
    ("sb3_maskable_ppo.classic", "action discrete 5", ""),
    ("godot_ppo_several.dynamo", "output continuous 7", ""),
    ("mlagents_discrete", "deterministic_discrete_actions discrete 3", ""),
    (
        "mlagents_both",
        "deterministic_continuous_actions continuous 2, deterministic_discrete_actions continuous 2",
        "",
    ),
    (
        "mlagents_lstm",
        "deterministic_continuous_actions continuous 2",
        "recurrent_in recurrent_out 24",
    ),
    ("torch_lstm_cell.classic", "actions continuous 4", "h_in h_out 16, c_in c_out 16"),
    ("torch_choice.classic", "action discrete 6", ""),
    ("torch_heads.dynamo", "output continuous 10", ""),
    ("torch_embedding.dynamo", "actions continuous 4", ""),
];

fn flags(name: &str) -> &'static [&'static str] {
    FLAGS.iter().find(|(start, _)| name.starts_with(start)).map_or(&[], |(_, flags)| flags)
}

/// The files whose names start like this, without their endings.
fn names(start: &str) -> Vec<String> {
    let entries = fs::read_dir(FOLDER).expect("the folder");
    let files =
        entries.map(|entry| entry.expect("a file").file_name().into_string().expect("text"));
    let names = files.filter_map(|file| file.strip_suffix(".onnx").map(str::to_owned));
    let mut names: Vec<String> = names.filter(|name| name.starts_with(start)).collect();
    names.sort();
    names
}

fn path(name: &str, ending: &str) -> String {
    format!("{FOLDER}/{name}.{ending}")
}

/// Compiles and compares every file of a producer.
fn all_agree(producer: &str, count: usize) {
    let names = names(producer);
    assert_eq!(names.len(), count, "{names:?}");
    for name in names {
        let (onnx, npz) = (path(&name, "onnx"), path(&name, "npz"));
        let report = json(&[&["verify", &onnx, "--npz", &npz, "--json"], flags(&name)].concat());
        let engines = report["engines"].as_array().expect("engines");
        let compared: Vec<&str> =
            engines.iter().filter_map(|engine| engine["name"].as_str()).collect();
        assert_eq!(compared[..2], ["plan against recorded", "tract against recorded"], "{name}");
        let is_recurrent =
            ["gru", "lstm", "rnn", "recurrent"].iter().any(|kind| name.contains(kind));
        let steps: Vec<&Value> = (engines.iter())
            .filter(|engine| engine["name"].as_str().is_some_and(|name| name.contains("100 steps")))
            .collect();
        assert_eq!(!steps.is_empty(), is_recurrent, "{name}: {compared:?}");
        for engine in steps {
            assert!(engine["families"].as_array().is_some_and(|all| all[0]["inputs"] == 100));
        }
    }
}

#[test]
fn operators_that_are_taken_apart_agree_with_what_was_recorded() {
    all_agree("apart", 4);
}

#[test]
fn quantised_policies_agree_with_what_was_recorded() {
    all_agree("quantised", 4);
}

#[test]
fn numbers_of_16_bits_agree_with_the_same_numbers_in_32() {
    all_agree("half", 1);
    all_agree("brain", 1);
}

#[test]
fn rsl_rl() {
    all_agree("rsl_rl_", 14);
}

#[test]
fn stable_baselines() {
    all_agree("sb3_", 26);
}

#[test]
fn godot_rl() {
    all_agree("godot_", 11);
}

#[test]
fn skrl() {
    all_agree("skrl_", 6);
}

#[test]
fn unity() {
    all_agree("mlagents_", 11);
    let drawn = output(&["inspect", &path("mlagents_earlier", "onnx")]);
    assert_fails(&drawn, 2, &["RandomNormalLike", "`--output continuous_actions:likeliest`"]);
}

#[test]
fn modules_of_ones_own() {
    all_agree("torch_", 50);
}

#[test]
fn what_is_what_is_found_without_flags() {
    let words = |values: &Value, of: &dyn Fn(&Value) -> String| {
        let values = values.as_array().expect("a list");
        values.iter().map(of).filter(|words| !words.is_empty()).collect::<Vec<_>>().join(", ")
    };
    let text = |value: &Value| value.as_str().expect("text").to_owned();
    for (name, outputs, states) in FOUND {
        let policy = &json(&["inspect", &path(name, "onnx"), "--json"])["policy"];
        let wanted = words(&policy["outputs"], &|output| match &output["role"] {
            Value::Object(role) => {
                let role = role.iter().map(|(role, size)| format!("{role} {size}"));
                format!("{} {}", text(&output["name"]), role.collect::<String>())
            }
            _ => String::new(),
        });
        assert_eq!(wanted, outputs, "{name}");
        let found = words(&policy["states"], &|state| {
            format!("{} {} {}", text(&state["input"]), text(&state["output"]), state["length"])
        });
        assert_eq!(found, states, "{name}");
    }
}

#[test]
fn weights_in_a_file_beside_it_belong_to_a_policy() {
    let folder = tempfile::tempdir().expect("a folder");
    let onnx = folder.path().join("rsl_rl_mlp.onnx").display().to_string();
    let data = folder.path().join("rsl_rl_mlp.onnx.data");
    fs::copy(path("rsl_rl_mlp", "onnx"), &onnx).expect("a copy");
    let plan = folder.path().join("policy.plan").display().to_string();
    let compile = || output(&["compile", &onnx, "-o", &plan]);
    for verb in [output(&["inspect", &onnx]), compile()] {
        assert_fails(&verb, 66, &["rsl_rl_mlp.onnx.data", "same folder"]);
    }
    fs::write(&data, b"short").expect("a file");
    assert_fails(&compile(), 65, &["rsl_rl_mlp.onnx.data", "fewer bytes"]);
    fs::copy(path("rsl_rl_mlp", "onnx.data"), &data).expect("a copy");
    assert!(compile().status.success());
    assert!(Path::new(&plan).exists());
}
