//! Policies that others exported: what is found in their files, and that they give what was recorded of them.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{BUNDLE, NO_ONNXRUNTIME, assert_fails, json, output, stderr};

const FOLDER: &str = "tests/golden/onnx-foreign";

/// A file, the flags that it needs, and what is found: inputs, outputs, states.
type Found = (&'static str, &'static [&'static str], &'static str, &'static str, &'static str);

/// The masks of the attention networks could mean anything: they are inputs like others.
const FILES: [Found; 11] = [
    (
        "alma_agent_flat.classic",
        &[],
        "entities observation, obs_mask extra, entity_mask extra",
        "q discrete 12",
        "",
    ),
    (
        "alma_agent_flat.dynamo",
        &[],
        "entities observation, obs_mask extra, entity_mask extra",
        "q discrete 12",
        "",
    ),
    (
        "epymarl_rnn.classic",
        &[],
        "obs observation, h state",
        "q discrete 9, h_out state",
        "h h_out 64",
    ),
    (
        "epymarl_rnn.dynamo",
        &[],
        "obs observation, h state",
        "q discrete 9, h_out state",
        "h h_out 64",
    ),
    ("sb3_dqn.classic", &[], "observation observation", "q discrete 5", ""),
    ("sb3_dqn.dynamo", &[], "observation observation", "q discrete 5", ""),
    (
        "sb3_maskable_ppo.classic",
        &[],
        "observation observation, action_mask available",
        "action discrete 5",
        "",
    ),
    ("sb3_ppo_discrete.classic", &[], "observation observation", "action discrete 5", ""),
    (
        "sb3_recurrent_ppo.classic",
        &[],
        "observation observation, h state, c state",
        "logits discrete 5, h_out state, c_out state",
        "h h_out 64, c c_out 64",
    ),
    (
        "torch_mha_own_query.classic",
        &["--size", "N=7"],
        "entities observation, pad extra",
        "q discrete 6",
        "",
    ),
    ("torch_mha_own_query.dynamo", &[], "entities observation, pad extra", "q discrete 6", ""),
];

fn onnx(name: &str) -> String {
    format!("{FOLDER}/{name}.onnx")
}

fn npz(name: &str) -> String {
    format!("{FOLDER}/{name}.npz")
}

/// Each of a list of objects in a few words.
fn list(values: &Value, words: impl Fn(&Value) -> String) -> String {
    let values = values.as_array().expect("a list");
    values.iter().map(words).collect::<Vec<_>>().join(", ")
}

/// A name and a role, which has a number behind it or none.
fn named(value: &Value) -> String {
    let role = match &value["role"] {
        Value::Object(role) => role.iter().map(|(role, size)| format!("{role} {size}")).collect(),
        role => role.as_str().expect("a role").to_owned(),
    };
    format!("{} {role}", value["name"].as_str().expect("a name"))
}

#[test]
fn what_is_what_is_found_in_every_file() {
    for (name, flags, inputs, outputs, states) in FILES {
        let report = json(&[&["inspect", &onnx(name), "--json"], flags].concat());
        let policy = &report["policy"];
        assert_eq!(list(&policy["inputs"], named), inputs, "{name}");
        assert_eq!(list(&policy["outputs"], named), outputs, "{name}");
        let pair = |state: &Value| {
            let word = |key: &str| state[key].as_str().expect("a name").to_owned();
            format!("{} {} {}", word("input"), word("output"), state["length"])
        };
        assert_eq!(list(&policy["states"], pair), states, "{name}");
        assert_eq!(report["engine"], "plan", "{name}");
        let plan = &report["plan"];
        assert!(plan["flash_bytes"].as_u64() > plan["arena_bytes"].as_u64(), "{name}: {plan}");
        assert!(policy["multiply_adds"].as_u64().is_some_and(|count| count > 1000), "{name}");
    }
}

#[test]
fn the_policy_is_smaller_than_its_file() {
    let report = json(&["inspect", &onnx("sb3_ppo_discrete.classic"), "--json"]);
    assert_eq!(report["operators"]["Gemm"], 6);
    assert_eq!(report["policy"]["operators"]["EinSum"], 3);
    assert_eq!(report["policy"]["multiply_adds"], 64 * (8 + 64 + 5));
    // Two layers of 64 have the same bias, which is stored once.
    assert_eq!(report["policy"]["parameters"], 64 * 8 + 64 * 64 + 64 + 5 * (64 + 1));
    let text = output(&["inspect", &onnx("sb3_recurrent_ppo.classic")]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    for words in
        ["`c` comes back as `c_out`, 64 numbers", "next recurrent state", "action, discrete 5"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    let unneeded = output(&["inspect", &onnx("alma_agent_flat.dynamo")]);
    let unneeded = String::from_utf8_lossy(&unneeded.stdout).into_owned();
    let line = unneeded.lines().find(|line| line.contains("entity2task_mask"));
    assert!(line.is_some_and(|line| line.ends_with("not needed")), "{unneeded}");
}

#[test]
fn networks_that_become_plans_are_shown_as_ever() {
    let report = json(&["inspect", "tests/golden/onnx/agent_small.onnx", "--json"]);
    assert!(report.get("policy").is_none() && report.get("engine").is_none(), "{report}");
    assert_eq!(report["inputs"][0][1], "f32 [N, 10]");
}

#[test]
fn every_file_gives_its_recorded_answers() {
    for (name, flags, _, outputs, _) in FILES {
        let arguments = ["verify", &onnx(name), "--npz", &npz(name), "--json"];
        let report = json(&[&arguments, flags].concat());
        let engines = report["engines"].as_array().expect("engines");
        let names: Vec<&str> =
            engines.iter().filter_map(|engine| engine["name"].as_str()).collect();
        assert_eq!(names[..2], ["plan against recorded", "tract against recorded"]);
        for engine in engines {
            let families = engine["families"].as_array().expect("outputs");
            assert_eq!(families.len(), outputs.split(", ").count(), "{name}: {engine}");
            let cases = if engine["name"].as_str().is_some_and(|name| name.contains("steps")) {
                100
            } else {
                64
            };
            assert!(families.iter().all(|family| family["inputs"] == cases), "{name}: {engine}");
        }
        assert_ne!(report["not_compared"][0], "onnxruntime", "{NO_ONNXRUNTIME}");
        assert_eq!(names[2], "onnxruntime against recorded");
        let together = |pair| format!("{pair}, 100 steps with the state fed back");
        let pairs = [
            "plan against tract",
            "plan against onnxruntime",
            "tract against onnxruntime",
            "plan against double precision",
            "tract against double precision",
            "onnxruntime against double precision",
        ];
        let pairs = if outputs.contains("state") { &pairs[..] } else { &[] };
        assert_eq!(names[3..], pairs.iter().map(together).collect::<Vec<_>>(), "{name}");
    }
}

#[test]
fn weights_of_eight_bits_are_judged_by_what_was_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("few.plan").display().to_string();
    for (name, outputs, discrete) in
        [("sb3_dqn.classic", 1, true), ("sb3_recurrent_ppo.classic", 1, true)]
    {
        let recorded = npz(name);
        let onnx = onnx(name);
        let compile = ["compile", &onnx, "-o", &plan, "--profile", "int8"];
        assert_fails(&output(&compile), 2, &["--observations", "--npz"]);
        let compile = [&compile[..], &["--npz", &recorded]].concat();
        assert_fails(&output(&compile), 1, &["64 observations say too little", "--force"]);
        assert!(!Path::new(&plan).exists());
        let report = json(&[&compile[..], &["--force", "--json"]].concat());
        let agreement = &report["agreement"];
        assert_eq!(agreement["observations"], 64);
        assert_eq!(agreement["outputs"].as_array().map(Vec::len), Some(outputs), "{name}");
        let first = &agreement["outputs"][0];
        assert_eq!(first["equal_actions"].is_u64(), discrete);
        let deviation = first["largest_deviation"].as_f64().expect("a number");
        assert!(deviation > 0.0 && deviation < 0.2, "{name}: {deviation}");
        let sizes = [&report["flash_bytes"], &report["exact"]["flash_bytes"]];
        assert!(2 * sizes[0].as_u64().unwrap() < sizes[1].as_u64().unwrap(), "{name}: {sizes:?}");
        // The plan says it of itself.
        let inspected = json(&["inspect", &plan, "--json"]);
        assert_eq!(&inspected["policy"]["agreement"], agreement);
        let other = 64 - first["equal_actions"].as_u64().expect("a count");
        assert_eq!(inspected["action_mismatch"].as_f64(), Some(other as f64 / 64.0));
        fs::remove_file(&plan).expect("a plan");
    }
}

#[test]
fn a_plan_knows_the_names_of_its_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("named.plan").display().to_string();
    let compiled = output(&["compile", &onnx("sb3_recurrent_ppo.classic"), "-o", &plan]);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    let facts = json(&["inspect", &plan, "--json"]);
    let policy = &facts["policy"]["facts"];
    assert_eq!(list(&policy["inputs"], named), "observation observation, h state, c state");
    let text = output(&["inspect", &plan]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.contains("observation") && text.contains("next recurrent state"), "{text}");
}

#[test]
fn without_a_recording_the_engines_are_compared_with_each_other() {
    let report = json(&["verify", &onnx("epymarl_rnn.classic"), "--inputs", "48", "--json"]);
    let first = &report["engines"][0];
    let name = first["name"].as_str().expect("a name");
    assert_eq!(name, "plan against tract, random inputs, the state fed back for 16");
    let families = first["families"].as_array().expect("outputs");
    assert!(families.len() == 2 && families.iter().all(|output| output["inputs"] == 48));
    let flags = ["verify", &onnx("sb3_ppo_discrete.classic"), "--output", "value", "--json"];
    let of_another = json(&flags);
    assert_eq!(of_another["engines"][0]["families"][0]["name"], "value");
}

/// A copy of a recorded file with some bytes replaced by as many others.
fn edited(folder: &Path, name: &str, from: &[u8], to: &[u8]) -> String {
    let mut bytes = fs::read(npz(name)).expect("a recorded file");
    let places: Vec<usize> = (0..bytes.len()).filter(|at| bytes[*at..].starts_with(from)).collect();
    assert!(!places.is_empty());
    for at in places {
        bytes[at..at + to.len()].copy_from_slice(to);
    }
    let path = folder.join("edited.npz").display().to_string();
    fs::write(&path, bytes).expect("an edited file");
    path
}

fn verify(onnx: &str, npz: &str) -> std::process::Output {
    output(&["verify", onnx, "--npz", npz, "--against", "tract"])
}

#[test]
fn other_answers_than_recorded_are_a_difference() {
    let folder = tempfile::tempdir().expect("a folder");
    // The last number of the last array.
    let name = "sb3_dqn.classic";
    let bytes = fs::read(npz(name)).expect("a recorded file");
    let end = bytes.windows(4).position(|four| four == b"PK\x01\x02").expect("a directory");
    let changed = [&bytes[end - 4..end - 2], &[0x80, 0x41]].concat();
    let path = edited(folder.path(), name, &bytes[end - 4..end + 2], &changed);
    assert_fails(&verify(&onnx(name), &path), 1, &["plan against recorded, q", "limit 16"]);

    // A choice that no score explains.
    let name = "sb3_maskable_ppo.classic";
    let bytes = fs::read(npz(name)).expect("a recorded file");
    let end = bytes.windows(4).position(|four| four == b"PK\x01\x02").expect("a directory");
    let from = &bytes[end - 16..end + 2];
    let other = (from[8] + 1) % 5;
    let changed = [&from[..8], &[other]].concat();
    let path = edited(folder.path(), name, from, &changed);
    assert_fails(&verify(&onnx(name), &path), 1, &["plan against recorded, action"]);
}

#[test]
fn recorded_files_that_do_not_fit_are_named_with_what_is_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let (name, onnx) = ("sb3_dqn.classic", onnx("sb3_dqn.classic"));
    let edited = |from: &[u8], to: &[u8]| edited(folder.path(), name, from, to);
    let other_name = edited(b"in__observation", b"in__observatioX");
    assert_fails(
        &verify(&onnx, &other_name),
        65,
        &["no `in__observation`", "in__observatioX", "out__q"],
    );
    let other_shape = edited(b"(64, 1, 8)", b"(32, 2, 8)");
    assert_fails(
        &verify(&onnx, &other_shape),
        65,
        &["`in__observation`", "[32, 2, 8]", "8 numbers"],
    );
    let bytes = fs::read(npz(name)).expect("a recorded file");
    let header = bytes.windows(6).position(|six| six == b"\x93NUMPY").expect("an array");
    let first = header + 128;
    let with_nan = edited(&bytes[first..first + 8], &f32::NAN.to_le_bytes());
    assert_fails(&verify(&onnx, &with_nan), 65, &["`in__observation`", "NaN in case 0"]);
    let cut = folder.path().join("cut.npz");
    fs::write(&cut, &bytes[..bytes.len() - 30]).expect("a cut file");
    assert_fails(&verify(&onnx, &cut.display().to_string()), 65, &["cut.npz", "numpy.savez"]);
    assert_fails(&verify(&onnx, "no.npz"), 66, &["no.npz"]);
}

#[test]
fn what_must_be_said_about_a_file_is_asked_for() {
    let open = onnx("torch_mha_own_query.classic");
    let words = ["`N`", "`entities`", "--size N=7"];
    assert_fails(&verify(&open, &npz("torch_mha_own_query.classic")), 2, &words);
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("policy.plan").display().to_string();
    assert_fails(&output(&["compile", &open, "-o", &plan]), 2, &words);
    let inspected = output(&["inspect", &open]);
    assert_fails(&inspected, 2, &words);
    let shown = String::from_utf8_lossy(&inspected.stdout).into_owned();
    assert!(shown.contains("f32 [1, N, 10]") && shown.contains("Softmax"), "{shown}");
    let several = onnx("sb3_ppo_discrete.classic");
    let words = ["`nothing`", "`action` i64 [1]", "`value` f32 [1, 1]"];
    assert_fails(&output(&["inspect", &several, "--output", "nothing"]), 2, &words);
    let states = ["inspect", &onnx("epymarl_rnn.classic"), "--state", "h:x"];
    assert_fails(&output(&states), 2, &["`h:x`", "`h_out` f32 [1, 64]"]);
    assert_fails(&output(&["inspect", &several, "--size", "N=0"]), 2, &["--size"]);
    let two = json(&["inspect", &several, "--output", "value", "--output", "action", "--json"]);
    assert_eq!(list(&two["policy"]["outputs"], named), "action discrete 5, value continuous 1");
    let said = json(&["inspect", &several, "--output", "value:discrete", "--json"]);
    assert_eq!(list(&said["policy"]["outputs"], named), "value discrete 1");
}

#[test]
fn flags_of_policies_go_with_policies() {
    let agent = onnx("sb3_dqn.classic");
    assert_fails(&output(&["inspect", BUNDLE, "--output", "q"]), 2, &["ONNX files"]);
    assert_fails(&output(&["verify", BUNDLE, "--output", "q"]), 2, &["an ONNX file"]);
    assert_fails(&output(&["verify", &agent, "--against", "golden"]), 2, &["a bundle"]);
    assert_fails(
        &output(&["verify", BUNDLE, "--npz", "x.npz", "--against", "tract"]),
        2,
        &["--npz"],
    );
}

#[test]
fn every_file_becomes_a_plan() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("policy.plan").display().to_string();
    for (name, flags, ..) in FILES {
        let compile = ["compile", &onnx(name), "-o", &plan, "--json"];
        let report = json(&[&compile, flags].concat());
        assert!(report["max_distance"].as_f64().is_some_and(|far| far <= 16.0), "{name}");
        let inspected = json(&["inspect", &plan, "--json"]);
        assert_eq!(inspected["network"], "policy", "{name}: {inspected}");
        for key in ["max_distance", "inputs"] {
            assert_eq!(inspected[key], report[key], "{name}: {inspected}");
        }
    }
}

#[test]
fn a_truncated_policy_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let half = folder.path().join("half.onnx").display().to_string();
    let bytes = fs::read(onnx("epymarl_rnn.classic")).expect("a policy");
    fs::write(&half, &bytes[..bytes.len() / 2]).expect("half of it");
    for run in [verify(&half, &npz("epymarl_rnn.classic")), output(&["inspect", &half])] {
        assert_fails(&run, 65, &["half.onnx"]);
        assert!(!stderr(&run).contains("panicked"), "{}", stderr(&run));
    }
}
