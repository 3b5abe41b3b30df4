//! Policies that were not trained here act for the agents of a team: from an ONNX file to a run.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use serde_json::Value;

use crate::support::{
    Ending as _, TestDomain, assert_fails, interrupt, json, output, sortie, wait_until,
};

const FOLDER: &str = "tests/golden/onnx-team";
const SET: &str = "group-matching/8x6x2";

fn onnx(name: &str) -> String {
    format!("{FOLDER}/{name}.onnx")
}

/// A bundle of one of the files, in a folder that its name tells.
fn export(home: &Path, name: &str, flags: &[&str]) -> String {
    let (onnx, bundle) = (onnx(name), home.join(name).display().to_string());
    let mut arguments = vec!["export", &onnx, "--env", SET, "--out", &bundle, "--episodes", "20"];
    arguments.extend(flags);
    arguments.push("--json");
    assert_eq!(json(&arguments)["bundle"], bundle.as_str());
    bundle
}

/// All engines agree, on so many comparisons.
fn verify(bundle: &str) {
    let report = json(&["verify", bundle, "--inputs", "64", "--against", "tract,golden", "--json"]);
    let engines = report["engines"].as_array().expect("a list of engines");
    let names: Vec<&str> = engines.iter().filter_map(|engine| engine["name"].as_str()).collect();
    let want = [
        "plan against tract",
        "plan against double precision",
        "plan against golden",
        "tract against golden",
    ];
    assert_eq!(names, want);
    for engine in engines {
        assert_eq!(engine["refusals_differ"], 0, "{engine}");
        assert!(engine["inputs"].as_u64() >= Some(64), "{engine}");
    }
}

fn play(bundle: &str, more: &[&str]) -> Value {
    let mut arguments = vec!["run", bundle, "--json", "--seed", "5", "--episodes", "5"];
    arguments.extend(more);
    json(&arguments)
}

#[test]
fn a_policy_over_the_own_row_becomes_a_bundle_that_plays() {
    let home = tempfile::tempdir().expect("a folder");
    let bundle = export(home.path(), "ring_mlp", &["--output", "logits"]);
    verify(&bundle);
    let facts = json(&["inspect", &bundle, "--json"]);
    assert_eq!(facts["network"]["agent"], "policy");
    assert_eq!(facts["contract"]["append_last_action"], false);
    let plan = json(&["inspect", &format!("{bundle}/agent.plan"), "--json"]);
    assert_eq!((&plan["network"], &plan["n_max"]), (&"policy".into(), &8.into()));
    // Its weights are a rule that always works, but for the noise.
    let played = play(&bundle, &["--in-process"]);
    assert_eq!(played["success"], 1.0, "{played}");
}

#[test]
fn a_recurrent_policy_plays_alike_in_processes_by_plan_and_by_tract() {
    let home = tempfile::tempdir().expect("a folder");
    let bundle = export(home.path(), "ring_gru", &[]);
    verify(&bundle);
    let facts = json(&["inspect", &bundle, "--json"]);
    assert_eq!(facts["network"]["hidden"], 8);
    assert_eq!(facts["contract"]["append_last_action"], true);
    let domain = TestDomain::new("others");
    let in_process = play(&bundle, &["--in-process"]);
    let processes = play(&bundle, &["--domain", &domain.id]);
    let tract = play(&bundle, &["--in-process", "--backend", "tract"]);
    for key in ["success", "return_mean", "decisions", "ticks"] {
        assert_eq!(in_process[key], processes[key], "{key}");
        assert_eq!(in_process[key], tract[key], "{key}");
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_supervised_team_of_a_recurrent_policy_plays_as_one_in_a_single_process() {
    let home = tempfile::tempdir().expect("a folder");
    let bundle = export(home.path(), "ring_gru", &[]);
    let in_process = play(&bundle, &["--in-process"]);
    for more in [&["--isolate"][..], &["--private"], &["--backend", "tract"]] {
        let domain = TestDomain::new("othersup");
        let up = ["up", &bundle, "--domain", &domain.id, "--json", "--seed", "5", "--rate", "0"];
        let played = json(&[&up[..], &["--episodes", "5"], more].concat());
        for key in ["success", "return_mean", "groups_gathered", "decisions"] {
            assert_eq!(in_process[key], played[key], "{key}, {more:?}");
        }
        assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    }
}

#[test]
fn the_doctor_misses_no_allocator_where_nothing_is_allocated() {
    let home = tempfile::tempdir().expect("a folder");
    let bundle = export(home.path(), "ring_gru", &[]);
    let domain = TestDomain::new("othersdoc");
    let mut up = sortie(&["up", &bundle, "--domain", &domain.id, "--quiet", "--isolate"])
        .stdout(Stdio::null())
        .spawn()
        .expect("the command line starts");
    wait_until("the doctor finds nothing wrong", || {
        let found = output(&["doctor", "--domain", &domain.id]);
        let text = String::from_utf8_lossy(&found.stdout).into_owned();
        found.status.success() && text.contains("none: there is nothing to allocate")
    });
    interrupt(&up);
    assert_eq!(up.ended().code(), Some(130));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn what_does_not_fit_the_environment_is_said() {
    let home = tempfile::tempdir().expect("a folder");
    let out = home.path().join("bundle").display().to_string();
    let export = |file: &str, more: &[&str]| {
        let arguments = ["export", file, "--out", &out, "--episodes", "1"];
        output(&[&arguments[..], more].concat())
    };
    let mlp = onnx("ring_mlp");
    assert_fails(&export(&mlp, &[]), 2, &["--env ENV/SET"]);
    let other = export(&mlp, &["--env", "save-the-city"]);
    assert_fails(&other, 78, &["ring_mlp.onnx", "`logits` chooses among 3 actions"]);
    let larger = export(&mlp, &["--env", "group-matching/10x10x2"]);
    assert_fails(&larger, 78, &["`obs` has 16 numbers, an agent's own row has 22 (22 features"]);
    let continuous = export(&mlp, &["--env", SET, "--output", "logits:continuous"]);
    assert_fails(&continuous, 78, &["`--output logits:discrete`"]);
    let several = export(&mlp, &["--env", SET, "--env", "group-matching/3x6x1"]);
    assert_fails(&several, 78, &["`group-matching/3x6x1` has other features"]);
    assert!(!home.path().join("bundle").exists());
}

#[test]
fn what_is_said_of_a_policy_stands_in_its_bundle() {
    let home = tempfile::tempdir().expect("a folder");
    let bundle = export(home.path(), "ring_gru", &["--state", "h:h_out"]);
    let roles = Path::new(&bundle).join("policy.toml");
    assert_eq!(fs::read_to_string(&roles).expect("roles"), "state = [\"h:h_out\"]\n");
    // The same again with plans of its own.
    let again = home.path().join("again").display().to_string();
    json(&["compile", &bundle, "-o", &again, "--json"]);
    let parts = |bundle: &str| json(&["inspect", bundle, "--json"])["parts"].clone();
    assert_eq!(parts(&bundle), parts(&again));
}

#[test]
fn a_network_over_entities_plays_alike_whichever_way_it_finds_itself() {
    let home = tempfile::tempdir().expect("a folder");
    let first = ["--entities", "entities", "--mask", "pad:blocked", "--self", "first"];
    let first = export(home.path(), "ring_first", &first);
    // The same by a file beside the network.
    let onnx = home.path().join("ring.onnx");
    fs::copy(format!("{FOLDER}/ring_index.onnx"), &onnx).expect("a copy");
    let toml = "entities = 'entities'
mask = 'visible:visible'
self = 'self_index'
";
    fs::write(home.path().join("ring.toml"), toml).expect("roles");
    let (onnx, index) = (onnx.display().to_string(), home.path().join("index"));
    let index = index.display().to_string();
    json(&["export", &onnx, "--env", SET, "--out", &index, "--episodes", "20", "--json"]);
    for bundle in [&first, &index] {
        verify(bundle);
        let plan = json(&["inspect", &format!("{bundle}/agent.plan"), "--json"]);
        assert_eq!((&plan["n_max"], &plan["features"]), (&10.into(), &16.into()));
    }
    let (first, index) = (play(&first, &["--in-process"]), play(&index, &["--in-process"]));
    for key in ["success", "return_mean", "decisions", "ticks"] {
        assert_eq!(first[key], index[key], "{key}");
    }
}

#[test]
fn roles_are_said_by_flags_before_files_and_other_keys_are_refused() {
    let home = tempfile::tempdir().expect("a folder");
    let (onnx, toml) = (home.path().join("ring.onnx"), home.path().join("ring.toml"));
    fs::copy(format!("{FOLDER}/ring_first.onnx"), &onnx).expect("a copy");
    let onnx = onnx.display().to_string();
    let write = |text: &str| fs::write(&toml, text).expect("roles");
    write(
        "entities = 'entities'
mask = 'pad:visible'
self = 'first'",
    );
    let role = |more: &[&str]| {
        let facts = json(&[&["inspect", &onnx, "--json"], more].concat());
        facts["policy"]["inputs"][1]["role"]["mask"]["blocks"].clone()
    };
    assert_eq!(role(&[]), false);
    assert_eq!(role(&["--mask", "pad:blocked"]), true);
    let other = home.path().join("other").display().to_string();
    fs::write(
        &other,
        "entities = 'entities'
mask = 'pad:blocked'
self = 'first'",
    )
    .expect("roles");
    assert_eq!(role(&["--contract", &other]), true);
    write("entity = 'entities'");
    let unknown = ["ring.toml", "unknown field `entity`, expected one of", "`entities`", "`self`"];
    assert_fails(&output(&["inspect", &onnx]), 65, &unknown);
    write("entities = 'entities'");
    assert_fails(&output(&["inspect", &onnx]), 2, &["`pad` bool [1, 10]", "--mask NAME:visible"]);
}
