//! Guards: from a file of their own into a plan, and in the plan that is served.

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;

use serde_json::{Value, json};
use sortie_core::plan::Trip;
use sortie_core::wire::{AnswerStatus, Reason};
use sortie_ipc::{ClientSettings, Domain, Expected, PolicyClient};

use crate::record::recorded_ticks;
use crate::support::{
    self, BUNDLE, Playing, TestDomain, assert_fails, interrupt, output, sortie, stderr,
};

const CART: &str = "examples/embed_c/cart.onnx";
const CART_SHAPE: Expected<'_> =
    Expected { inputs: &[("position", 1)], outputs: &[("force", 1)], actions: 0 };
/// A policy that chooses among actions, and what was recorded of it.
const RECURRENT: &str = "tests/golden/onnx-foreign/epymarl_rnn.classic.onnx";
const RECORDED: &str = "tests/golden/onnx-foreign/epymarl_rnn.classic.npz";

/// A folder in which guards are written and plans are compiled.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a folder") }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    /// Compiles with these guards and flags.
    fn compile(&self, onnx: &str, guards: &str, more: &[&str]) -> std::process::Output {
        fs::write(self.path("guards.toml"), guards).expect("a file");
        let (plan, file) = (self.path("guarded.plan"), self.path("guards.toml"));
        output(&[&["compile", onnx, "-q", "-o", &plan, "--guards", &file], more].concat())
    }

    fn inspected(&self) -> Value {
        support::json(&["inspect", &self.path("guarded.plan"), "--json"])
    }
}

#[test]
fn a_trip_reaches_the_robot_in_the_same_tick_and_the_summary_names_it() {
    let bench = Bench::new();
    let guards = "hold = 1\nfallback = [0.25]\n[inputs]\nlowest = [-1.5]\nhighest = [1.5]\n\
                  [outputs]\nlowest = [-1]\nhighest = [1]\n";
    let compiled = bench.compile(CART, guards, &[]);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    let plan = bench.path("guarded.plan");
    let unguarded = fs::read("examples/embed_c/cart.plan").expect("the plan");
    let bytes = fs::read(&plan).expect("a plan");
    assert!(bytes.len() > unguarded.len());
    let domain = TestDomain::new("guarded");
    let server = sortie(&["serve", &plan, "--domain", &domain.id, "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command line starts");
    let settings = ClientSettings {
        deadline: Some(Duration::from_secs(60)),
        patience: Duration::from_secs(60),
        ..ClientSettings::default()
    };
    let of = Domain::new(&domain.id).expect("a domain");
    let mut client = PolicyClient::connect(&of, &CART_SHAPE, &settings).expect("a server");
    let range = Some(Trip::InputRange { index: 0 });
    for (position, status, reason, guard) in [
        (0.5, AnswerStatus::Answered, Reason::None, None),
        (f32::NAN, AnswerStatus::Fallback, Reason::Guard, range),
        (0.5, AnswerStatus::Fallback, Reason::Guard, Some(Trip::Held)),
        (1.5, AnswerStatus::Answered, Reason::None, None),
        (1.6, AnswerStatus::Fallback, Reason::Guard, range),
    ] {
        let action = client.decide(&[&[position]], &[]).expect("the policy's lengths");
        assert_eq!((action.status, action.reason, action.guard), (status, reason, guard));
        let is_safe = action.outputs == [0.25];
        assert_eq!(is_safe, status == AnswerStatus::Fallback, "{position}");
    }
    drop(client);
    interrupt(&server);
    let ended = server.wait_with_output().expect("its output");
    let told = String::from_utf8_lossy(&ended.stderr).into_owned();
    let words = "guard `input_range` tripped at observation 2: input 0 is outside of its range";
    assert_eq!(told.matches("guard `").count(), 1, "{told}");
    assert!(told.contains(words), "{told}");
    let summary: Value = serde_json::from_slice(&ended.stdout).expect("one JSON object");
    let counts = ["answered", "fallbacks", "guarded", "clamped"].map(|name| summary[name].as_u64());
    assert_eq!(counts, [2, 3, 3, 0].map(Some), "{summary}");
    let trips = json!([
        { "guard": "input_range", "index": 0, "observations": 2 },
        { "guard": "held", "observations": 1 },
    ]);
    assert_eq!(summary["trips"], trips);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn ranges_of_inputs_come_from_what_was_recorded() {
    let bench = Bench::new();
    let ranges = |margin: &str| {
        let more = ["--npz", RECORDED, "--guard-inputs", margin];
        let compiled = bench.compile(RECURRENT, "age_ms = 20\n", &more);
        assert!(compiled.status.success(), "{}", stderr(&compiled));
        let guards = bench.inspected()["guards"].clone();
        assert_eq!(guards["age_ms"], 20.0);
        ["lowest", "highest"].map(|name| {
            let numbers = guards["inputs"][name].as_array().expect("a list").clone();
            numbers.iter().map(|number| number.as_f64().expect("a number")).collect::<Vec<_>>()
        })
    };
    let ([lowest, highest], [lower, higher]) = (ranges("0"), ranges("0.5"));
    assert_eq!(lowest.len(), 40);
    for index in 0..40 {
        let width = highest[index] - lowest[index];
        assert!(width > 0.0);
        assert!((lowest[index] - lower[index] - 0.5 * width).abs() < 1e-5 * width, "{index}");
        assert!((higher[index] - highest[index] - 0.5 * width).abs() < 1e-5 * width, "{index}");
    }
    let shown = output(&["inspect", &bench.path("guarded.plan")]);
    let shown = String::from_utf8(shown.stdout).expect("text");
    for words in ["lowest 40 numbers, highest 40 numbers", "at most 20 ms", "the caller's"] {
        assert!(shown.contains(words), "{words}: {shown}");
    }
}

#[test]
fn guards_that_cannot_be_are_refused_by_name() {
    let bench = Bench::new();
    let refused = |onnx: &str, guards: &str, more: &[&str], code: i32, words: &[&str]| {
        assert_fails(&bench.compile(onnx, guards, more), code, words);
        assert!(!bench.folder.path().join("guarded.plan").exists(), "{guards}");
    };
    let flaws = [
        ("[outputs]\nlowest = [2]\nhighest = [1]", "`outputs.lowest` is above `outputs.highest`"),
        ("[inputs]\nlowest = [nan]", "`inputs.lowest` is NaN at 0"),
        ("[inputs]\nlowest = [0, 0, 0]", "`inputs.lowest` has 3 numbers, needed are 1 or 1"),
        ("hold = 3", "nothing is guarded"),
        ("fallback = \"sleep\"\nage_ms = 2", "expected `hold`, `zero`, or a list of numbers"),
        ("age = 2", "unknown field `age`"),
    ];
    for (guards, words) in flaws {
        refused(CART, guards, &[], 65, &["guards.toml", words]);
    }
    let scores = "[outputs]\nlowest = [2]";
    refused(RECURRENT, scores, &[], 65, &["the policy chooses among actions"]);
    let twice = ["--npz", RECORDED, "--guard-inputs", "0.1"];
    refused(RECURRENT, "[inputs]\nlowest = [0]", &twice, 2, &["`--guard-inputs`", "leave"]);
    refused(RECURRENT, "age_ms = 2", &["--guard-inputs", "0.1"], 2, &["--npz"]);
    refused(RECURRENT, "age_ms = 2", &["--npz", RECORDED, "--guard-inputs", "-1"], 2, &["share"]);
    let agent = format!("{BUNDLE}/agent.onnx");
    refused(&agent, "age_ms = 2", &["--n-max", "11"], 2, &["agents of a team observe entities"]);
    refused(BUNDLE, "age_ms = 2", &[], 65, &["guards.toml", "expected `features`"]);
    let range = "[features]\nx-scale = [0, 1]";
    refused(BUNDLE, range, &[], 65, &["guards.toml", "the contract has no feature `x-scale`"]);
    let twice = ["--guard-inputs", "0.1"];
    refused(BUNDLE, range, &twice, 2, &["leave one of them out"]);
    refused(BUNDLE, range, &["--profile", "int8"], 2, &["guards of a team stand in its bundle"]);
    refused(BUNDLE, range, &["--observations", "seen.bin"], 2, &["`--observations` is for"]);
}

#[test]
fn an_agent_that_observes_what_its_bundle_is_guarded_against_falls_back_and_the_record_knows() {
    let bench = Bench::new();
    let bundle = bench.path("guarded.plan");
    let compiled = bench.compile(BUNDLE, "[features]\nx-scaled = [0, 0.5]\n", &[]);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    let domain = TestDomain::new("guarded-team");
    let name = bench.path("run.mcap");
    let up = Playing::of(&bundle, &domain, &["--rate", "100"]);
    let told = support::json(&[
        "record", &bundle, "--output", &name, "--domain", &domain.id, "--ticks", "400", "--json",
    ]);
    assert!(told["ticks"].as_u64() >= Some(400), "{told}");
    let top = support::json(&["top", "--domain", &domain.id, "--for", "1", "--json"]);
    up.shut_down(&domain);
    let remade = support::json(&["remake", &name, "--json"]);
    assert_eq!(remade["different"], 0, "{remade}");
    assert!(remade["actions"].as_u64() > Some(400), "{remade}");
    // Of this town's east nobody knows anything, and whoever sees it does what is safe.
    let agents = top["agents"].as_array().expect("agents");
    let guarded: u64 = agents.iter().filter_map(|agent| agent["guarded_total"].as_u64()).sum();
    assert!(guarded > 0, "{top}");
    let ticks = recorded_ticks(&name);
    let answers = ticks.iter().flat_map(|tick| {
        let agents = tick["agents"].as_array().cloned().unwrap_or_default();
        agents.into_iter().map(|answer| (tick["tick"].clone(), answer))
    });
    let [guarded, free]: [Vec<_>; 2] = {
        let (guarded, free) = answers.partition(|(_, answer)| answer["guarded"] == true);
        [guarded, free]
    };
    assert!(guarded.len() > 20 && free.len() > 20, "{} of {}", guarded.len(), free.len());
    assert!(guarded.iter().all(|(_, answer)| answer["fallback"] == true));
    // It stays where it is, which the contract says is safe.
    let stays = guarded.iter().filter(|(_, answer)| answer["action"] == 0).count();
    assert!(stays * 10 > guarded.len() * 9, "{stays} of {}", guarded.len());
    let ran = support::json(&["run", &bundle, "--episodes", "3", "--rate", "0", "--json"]);
    let [fallbacks, guarded_in_all] = ["fallbacks", "guarded"].map(|key| ran[key].as_u64());
    assert!(guarded_in_all > Some(0) && fallbacks >= guarded_in_all, "{ran}");
    let (tick, answer) = &guarded[guarded.len() / 2];
    let (tick, agent) = (tick.to_string(), answer["agent"].to_string());
    let why = support::json(&["why", &name, "--agent", &agent, "--tick", &tick, "--json"]);
    let reason = why["refused_for"].as_str().expect("a reason");
    assert!(reason.starts_with("`x-scaled` of entity "), "{reason}");
    assert!(reason.ends_with(", outside of its guarded range"), "{reason}");
}

#[test]
fn ranges_of_a_team_come_from_episodes_that_it_plays() {
    let bench = Bench::new();
    let bundle = bench.path("guarded.plan");
    let compile = ["compile", BUNDLE, "-q", "-o", &bundle, "--guard-inputs", "0"];
    let compiled = output(&compile);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    let inspected = bench.inspected();
    assert_eq!(inspected["format"], 5, "{inspected}");
    let ranges = inspected["guards"].as_object().expect("ranges");
    assert_eq!(Some(ranges.len() as u64), inspected["contract"]["features"].as_u64());
    assert_eq!(ranges["can-fight"], json!([0.0, 1.0]));
    let shown = output(&["inspect", &bundle]);
    let shown = String::from_utf8(shown.stdout).expect("text");
    assert!(shown.contains("58 of 58 features"), "{shown}");
    // Its plans are those of the bundle without guards, and so is what they are verified by.
    let of = |inspected: &Value| inspected["parts"]["agent.plan"].clone();
    assert_eq!(of(&inspected), of(&support::json(&["inspect", BUNDLE, "--json"])));
    let text = fs::read(format!("{bundle}/guards.toml")).expect("guards");
    let cut = String::from_utf8(text).expect("text").replace("features", "feature");
    fs::write(format!("{bundle}/guards.toml"), cut).expect("a file");
    assert_fails(&output(&["inspect", &bundle]), 65, &["guards.toml", "SHA-256"]);
}

#[test]
fn a_plan_whose_guards_are_damaged_is_neither_served_nor_shown() {
    let bench = Bench::new();
    let whole = fs::read("tests/golden/plans/guarded-2.3.plan").expect("a plan");
    let end = fs::metadata("examples/embed_c/cart.plan").expect("a plan").len() as usize;
    let domain = TestDomain::new("damaged");
    let path = bench.path("damaged.plan");
    let mut renamed = whole.clone();
    renamed[end + 7] ^= 1;
    let mut changed = whole.clone();
    *changed.last_mut().expect("bytes") ^= 1;
    for bytes in [&renamed[..], &changed[..], &whole[..whole.len() - 1], &whole[..=end]] {
        fs::write(&path, bytes).expect("a file");
        for words in [&["serve", &path, "--domain", &domain.id][..], &["inspect", &path]] {
            assert_fails(&output(words), 65, &["damaged.plan", "guards may be missing"]);
        }
    }
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}
