//! `sortie serve`: a policy decides for a program of its own, until Ctrl-C.

use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::Duration;

use serde_json::Value;
use sortie_core::plan::{AlignedBytes, Given, Plan, RobotFacts};
use sortie_core::wire::{AnswerStatus, Reason};
use sortie_ipc::{ClientSettings, Domain, Expected, PolicyClient, PolicySchema};

use crate::support::{
    BUNDLE, TestDomain, assert_fails, interrupt, json, output, sortie, stderr, wait_until,
};

const CART: &str = "examples/embed_c/cart.plan";
const CART_SHAPE: Expected<'_> =
    Expected { inputs: &[("position", 1)], outputs: &[("force", 1)], actions: 0 };
/// A recurrent policy of which no plan can be made.
const SCATTERS: &str = "tests/golden/onnx-unplanned/scatters.onnx";
const ENGINE: &str = "tract: allocates, no promise about bits or time";
/// A recurrent network with scores of 9 actions.
const RECURRENT: &str = "tests/golden/onnx-foreign/epymarl_rnn.classic.onnx";
const RECURRENT_SHAPE: Expected<'_> =
    Expected { inputs: &[("obs", 40)], outputs: &[("q", 9)], actions: 9 };
/// Draws after which an action's share is near its probability.
const DRAWS: usize = 1_000;

fn serve(policy: &str, domain: &TestDomain) -> Child {
    serve_with(policy, domain, &[])
}

fn serve_with(policy: &str, domain: &TestDomain, more: &[&str]) -> Child {
    let arguments = ["serve", policy, "--domain", &domain.id, "--json"];
    sortie(&[&arguments, more].concat())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the command line starts")
}

/// What it prints after Ctrl-C.
fn summary(child: Child) -> Value {
    interrupt(&child);
    let ended = child.wait_with_output().expect("its output");
    assert_eq!(ended.status.code(), Some(0), "{}", stderr(&ended));
    serde_json::from_slice(&ended.stdout).expect("one JSON object")
}

fn connect(domain: &TestDomain, expected: &Expected<'_>) -> PolicyClient {
    let domain = Domain::new(&domain.id).expect("a domain");
    let settings = ClientSettings {
        deadline: Some(Duration::from_secs(60)),
        patience: Duration::from_secs(60),
        ..ClientSettings::default()
    };
    PolicyClient::connect(&domain, expected, &settings).expect("a server")
}

#[test]
fn a_plan_is_served_until_ctrl_c() {
    let domain = TestDomain::new("cart");
    let server = serve(CART, &domain);
    let mut client = connect(&domain, &CART_SHAPE);
    for _ in 0..20 {
        let action = client.decide(&[&[0.5]], &[]).expect("the policy's lengths");
        assert_eq!(action.status, AnswerStatus::Answered);
    }
    let second = output(&["serve", CART, "--domain", &domain.id]);
    assert_fails(&second, 75, &["the policy of domain", "already taken", "--domain NAME"]);
    drop(client);
    let summary = summary(server);
    let counts = ["answered", "sessions", "resets", "late", "fallbacks", "refused"]
        .map(|name| summary[name].as_u64());
    assert_eq!(counts, [20, 1, 1, 0, 0, 0].map(Some), "{summary}");
    assert!(summary["decide_us"]["p50"].as_f64() > Some(0.0), "{summary}");
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_team_that_has_ended_is_not_missed_while_a_policy_is_served() {
    let domain = TestDomain::new("both");
    let server = serve(CART, &domain);
    drop(connect(&domain, &CART_SHAPE));
    let team = ["run", BUNDLE, "--domain", &domain.id, "--episodes", "1", "--rate", "0"];
    let played = output(&team);
    assert!(played.status.success(), "{}", stderr(&played));
    let examined = json(&["doctor", "--domain", &domain.id, "--json"]);
    assert_eq!(examined["problems"], 0, "{examined}");
    let found = examined["findings"].as_array().expect("findings");
    let teams = found.iter().filter(|finding| finding["check"] == "team");
    let told: Vec<&Value> = teams.map(|finding| &finding["found"]).collect();
    assert_eq!(told, ["none: the last one has ended"]);
    summary(server);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn what_a_robot_states_of_itself_is_checked() {
    let test = TestDomain::new("robot");
    let server = serve("tests/golden/onnx-written/mjlab_velocity.onnx", &test);
    let expected = Expected { inputs: &[("obs", 27)], outputs: &[("actions", 6)], actions: 0 };
    let client = connect(&test, &expected);
    let domain = Domain::new(&test.id).expect("a domain");
    let robot = client.schema().robot.clone().expect("facts");
    assert_eq!(robot.joint_names[3], "knee");
    let check = |stated: &RobotFacts| client.schema().check_robot(&domain, stated);
    assert!(check(&robot).is_ok() && check(&RobotFacts::default()).is_ok());
    let mut other = robot.clone();
    other.joint_names.swap(0, 1);
    let refused = check(&other).unwrap_err().to_string();
    assert!(refused.contains("joint_names is hip_roll,hip_yaw"), "{refused}");
    drop(client);
    summary(server);
}

#[test]
fn a_recurrent_policy_of_an_onnx_file_chooses_among_available_actions() {
    let domain = TestDomain::new("onnx");
    let server = serve(RECURRENT, &domain);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("policy.plan");
    let compiled = output(&["compile", RECURRENT, "-q", "-o", &file.display().to_string()]);
    assert!(compiled.status.success(), "{}", stderr(&compiled));
    let bytes = AlignedBytes::copy_of(&std::fs::read(file).expect("the plan"));
    let plan = Plan::load(bytes.as_slice()).expect("a plan");
    let schema = PolicySchema::of_plan(&plan).expect("a policy's");
    let (inputs, actions) = (schema.inputs[0].length, schema.actions);
    assert_eq!(actions, 9);
    let expected = Expected { inputs: &[("obs", inputs)], outputs: &[("q", 9)], actions };
    let mut client = connect(&domain, &expected);
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut states = vec![0.0; plan.hidden()];
    for step in 0..60_usize {
        if step % 20 == 0 {
            client.begin_episode();
            states.fill(0.0);
        }
        let input: Vec<f32> =
            (0..inputs).map(|index| ((step * 31 + index * 17) % 23) as f32 / 11.0 - 1.0).collect();
        let available: Vec<u16> = (0..9).map(|action| u16::from((step + action) % 3 > 0)).collect();
        let given = Given { inputs: &[&input], available: &available };
        let chosen = plan.choose(arena.as_mut_slice(), &given, &mut states).expect("a choice");
        let action = client.decide(&[&input], &available).expect("the policy's lengths");
        assert_eq!((action.status, action.action), (AnswerStatus::Answered, Some(chosen.action)));
        let score = action.outputs[usize::from(chosen.action)];
        assert_eq!(score.to_bits(), chosen.utility.to_bits(), "step {step}");
    }
    let none = client.decide(&[&vec![0.0; inputs]], &[0; 9]).expect("the policy's lengths");
    let fallback = (AnswerStatus::Fallback, Reason::NoAvailableAction, None);
    assert_eq!((none.status, none.reason, none.action), fallback);
    drop(client);
    let summary = summary(server);
    assert_eq!((summary["answered"].as_u64(), summary["fallbacks"].as_u64()), (Some(60), Some(1)));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn actions_are_drawn_by_their_scores_and_a_seed() {
    let drawn = |more: &[&str]| {
        let domain = TestDomain::new("drawn");
        let server = serve_with(RECURRENT, &domain, &[&["--draw"], more].concat());
        let mut client = connect(&domain, &RECURRENT_SHAPE);
        let mut available = [1; 9];
        available[3] = 0;
        let mut scores = [0.0; 9];
        let mut decide = || {
            client.begin_episode();
            let action = client.decide(&[&[0.5; 40]], &available).expect("the policy's lengths");
            assert_eq!(action.status, AnswerStatus::Answered);
            scores.copy_from_slice(action.outputs);
            action.action.expect("a choice")
        };
        let actions: Vec<u16> = (0..DRAWS).map(|_| decide()).collect();
        let weights: Vec<f32> = scores
            .iter()
            .zip(available)
            .map(|(score, code)| f32::from(code) * score.exp())
            .collect();
        let total: f32 = weights.iter().sum();
        for (action, weight) in (0..).zip(weights) {
            let count = actions.iter().filter(|drawn| **drawn == action).count();
            let (got, want) = (count as f32 / DRAWS as f32, weight / total);
            assert!((got - want).abs() <= 0.3 * want, "action {action}: {got}, not {want}");
        }
        drop(client);
        summary(server);
        actions
    };
    let actions = drawn(&["--seed", "7"]);
    assert_eq!(actions, drawn(&["--seed", "7", "--backend", "tract"]));
    assert_ne!(actions, drawn(&["--seed", "8"]));
}

/// Scores of actions that are said to be numbers: nothing is chosen.
#[test]
fn what_stands_beside_a_policy_or_in_a_named_file_says_what_is_served() {
    let folder = tempfile::tempdir().expect("a folder");
    let [onnx, beside, named] =
        ["rnn.onnx", "rnn.toml", "other.toml"].map(|name| folder.path().join(name));
    std::fs::copy(RECURRENT, &onnx).expect("a copy");
    let [onnx, other] = [&onnx, &named].map(|path| path.display().to_string());
    let cases: [(_, &[&str]); 2] =
        [(beside, &[]), (named, &["--contract", &other, "--backend", "tract"])];
    for (file, more) in cases {
        std::fs::write(&file, "output = \"q:continuous\"\n").expect("a contract");
        let domain = TestDomain::new("contract");
        let server = serve_with(&onnx, &domain, more);
        connect(&domain, &Expected { actions: 0, ..RECURRENT_SHAPE });
        summary(server);
        std::fs::remove_file(file).expect("it is there");
    }
    let domain = TestDomain::new("contract");
    let missing = ["serve", &onnx, "--domain", &domain.id, "--contract", &other];
    assert_fails(&output(&missing), 66, &["other.toml"]);
}

#[test]
fn what_cannot_be_served_is_refused() {
    let domain = TestDomain::new("refused");
    let serve = |more: &[&str]| output(&[&["serve", "--domain", &domain.id], more].concat());
    assert_fails(&serve(&["nothing.plan"]), 66, &["nothing.plan"]);
    let of_team = serve(&["tests/golden/plans/agent-2.0.plan"]);
    assert_fails(&of_team, 65, &["agent-2.0.plan: the policy cannot be served"]);
    assert_fails(&serve(&["README.md"]), 65, &["README.md"]);
    let fallback = serve(&[CART, "--fallback", "3"]);
    assert_fails(&fallback, 65, &["its fallback is `hold` or `zero`"]);
    let draw = serve(&[CART, "--draw"]);
    assert_fails(&draw, 65, &["it does not choose among actions: there is none to draw"]);
    let usage = serve(&[CART, "--fallback", "sleep"]);
    assert_eq!(usage.status.code(), Some(2));
    let usage = serve(&[CART, "--deadline-ms", "0"]);
    assert_eq!(usage.status.code(), Some(2));
    let plan = serve(&[CART, "--backend", "tract"]);
    assert_fails(&plan, 2, &["cart.plan: this is a plan", "the ONNX file that it was made of"]);
    // A file whose weights lie in another one.
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("alone.onnx");
    let with_data = "tests/golden/onnx-producers/rsl_rl_mlp.onnx";
    std::fs::copy(with_data, &alone).expect("a copy");
    assert_fails(&serve(&[&alone.display().to_string()]), 66, &["must lie in the same folder"]);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

/// What `sortie control` and `sortie doctor` say of a domain.
fn told(domain: &TestDomain, words: &[&str]) -> String {
    let told = output(&[words, &["--domain", &domain.id]].concat());
    String::from_utf8(told.stdout).expect("text")
}

#[test]
fn a_server_is_seen_and_ended_from_outside() {
    let domain = TestDomain::new("told");
    let server = serve(CART, &domain);
    let mut client = connect(&domain, &CART_SHAPE);
    client.decide(&[&[0.5]], &[]).expect("the policy's lengths");
    let info = told(&domain, &["control", "info"]);
    let words = format!("runner {}, serves a policy, observation 1, model ", server.id());
    assert!(info.starts_with(&words) && info.lines().count() == 1, "{info}");
    wait_until("the doctor hears the server", || {
        let found = told(&domain, &["doctor"]);
        let has = |words: &str| found.contains(words);
        has(" [1] -> [1], schema ")
            && has(", deadline 20 ms, fallback hold")
            && has(&format!("process {}, model ", server.id()))
            && has(", 1 answers, 0 late, 0 fallbacks")
    });
    let pause = output(&["control", "pause", "--domain", &domain.id]);
    assert_fails(&pause, 69, &["no process that could do it has answered"]);
    let ended = told(&domain, &["control", "shut-down"]);
    assert!(ended.starts_with("runner "), "{ended}");
    let ended = server.wait_with_output().expect("its output");
    assert_eq!(ended.status.code(), Some(0), "{}", stderr(&ended));
    let summary: Value = serde_json::from_slice(&ended.stdout).expect("one JSON object");
    assert_eq!((summary["answered"].as_u64(), summary["engine"].as_str()), (Some(1), Some("plan")));
    drop(client);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_file_without_a_plan_is_run_by_tract_where_that_is_said() {
    let domain = TestDomain::new("scatters");
    let refused = output(&["serve", SCATTERS, "--domain", &domain.id]);
    let words = [
        "`scatter` (ScatterElements f32 [1, 6], i64 [1, 6], f32 [1, 6]) does not fit",
        "plans put numbers at constant places",
        "`--backend tract` still runs this file on a host",
    ];
    assert_fails(&refused, 65, &words);
    let server = serve_with(SCATTERS, &domain, &["--backend", "tract"]);
    let expected = Expected { inputs: &[("obs", 6)], outputs: &[("q", 5)], actions: 5 };
    let mut client = connect(&domain, &expected);
    let mut state = [0.0; 6];
    for step in 0..20_usize {
        if step == 12 {
            client.begin_episode();
            state = [0.0; 6];
        }
        let input: [f32; 6] = std::array::from_fn(|index| ((step * 7 + index * 5) % 11) as f32);
        for (state, input) in state.iter_mut().zip(input) {
            *state = (*state + input) / 2.0;
        }
        let scores = [4, 2, 0, 5, 1].map(|place: usize| state[place]);
        let mut available = [1; 5];
        available[step % 5] = 0;
        let action = client.decide(&[&input], &available).expect("the policy's lengths");
        assert_eq!((action.status, action.outputs), (AnswerStatus::Answered, &scores[..]));
        let chosen = usize::from(action.action.expect("a choice"));
        let best = (0..5).filter(|index| available[*index] != 0).map(|index| scores[index]);
        assert_eq!(scores[chosen], best.fold(f32::MIN, f32::max), "step {step}");
    }
    // Refused as by plans, and the state stays.
    let nan = client.decide(&[&[f32::NAN; 6]], &[1; 5]).expect("the policy's lengths");
    assert_eq!((nan.status, nan.reason), (AnswerStatus::Fallback, Reason::NonFinite));
    let huge = client.decide(&[&[f32::MAX; 6]], &[1; 5]).expect("the policy's lengths");
    assert_eq!(huge.status, AnswerStatus::Answered, "{:?}", huge.reason);
    let infinite = client.decide(&[&[f32::MAX; 6]], &[1; 5]).expect("the policy's lengths");
    assert_eq!((infinite.status, infinite.reason), (AnswerStatus::Fallback, Reason::NonFinite));
    // So is a state that no score shows.
    client.begin_episode();
    for (status, reason) in
        [(AnswerStatus::Answered, Reason::None), (AnswerStatus::Fallback, Reason::NonFinite)]
    {
        let hidden = [0.0, 0.0, 0.0, f32::MAX, 0.0, 0.0];
        let action = client.decide(&[&hidden], &[1; 5]).expect("the policy's lengths");
        assert_eq!((action.status, action.reason), (status, reason));
    }
    let info = told(&domain, &["control", "info"]);
    let sha256 = sortie_bundle::sha256(&std::fs::read(SCATTERS).expect("the file"));
    let model: String = sha256[..4].iter().map(|byte| format!("{byte:02x}")).collect();
    let ending = format!(", model {model}, by {ENGINE}");
    assert!(info.trim_end().ends_with(&ending), "{info}");
    wait_until("the doctor hears the server", || {
        told(&domain, &["doctor"])
            .contains("runs the graph: allocates, no promise about bits or time")
    });
    drop(client);
    let summary = summary(server);
    assert_eq!(summary["engine"], ENGINE);
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn tract_serves_what_a_plan_of_the_same_file_serves() {
    let recurrent = ("tests/golden/onnx-foreign/sb3_ppo_discrete.classic.onnx", 30);
    for (file, steps) in [(RECURRENT, 30), recurrent] {
        let domains = [TestDomain::new("by-plan"), TestDomain::new("by-tract")];
        let servers =
            [serve(file, &domains[0]), serve_with(file, &domains[1], &["--backend", "tract"])];
        let mut clients = domains.each_ref().map(|domain| {
            let domain = Domain::new(&domain.id).expect("a domain");
            let minute = Some(Duration::from_secs(60));
            let settings = ClientSettings {
                deadline: minute,
                patience: Duration::from_secs(60),
                ..ClientSettings::default()
            };
            PolicyClient::connect_for_threads(&domain, &settings).expect("a server")
        });
        // What a robot must know stands in plans alone.
        let schema = PolicySchema { robot: None, ..clients[0].schema().clone() };
        assert_eq!(&schema, clients[1].schema(), "{file}");
        let available = vec![1; schema.actions];
        for step in 0..steps {
            let number = |index: usize| ((step * 31 + index * 17) % 23) as f32 / 11.0 - 1.0;
            let inputs: Vec<Vec<f32>> =
                schema.inputs.iter().map(|port| (0..port.length).map(number).collect()).collect();
            let inputs: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
            let [(plan, chosen), (graph, also)] = clients.each_mut().map(|client| {
                let action = client.decide(&inputs, &available).expect("the policy's lengths");
                assert_eq!(action.status, AnswerStatus::Answered, "{file}: {:?}", action.reason);
                (action.outputs.to_vec(), action.action)
            });
            assert_eq!(chosen, also, "{file}, step {step}");
            for (plan, graph) in plan.iter().zip(&graph) {
                assert!(
                    (plan - graph).abs() <= 1e-5 * (1.0 + graph.abs()),
                    "{file}: {plan}, {graph}"
                );
            }
        }
        drop(clients);
        servers.into_iter().for_each(|server| drop(summary(server)));
    }
}
