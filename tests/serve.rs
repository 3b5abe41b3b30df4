//! `sortie serve`: a policy decides for a program of its own, until Ctrl-C.

mod support;

use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::Duration;

use serde_json::Value;
use sortie_core::plan::{AlignedBytes, Given, Plan};
use sortie_core::wire::{AnswerStatus, Reason};
use sortie_ipc::{ClientSettings, Domain, Expected, PolicyClient, PolicySchema};
use support::{TestDomain, assert_fails, interrupt, output, sortie, stderr};

const CART: &str = "examples/embed_c/cart.plan";
const CART_SHAPE: Expected<'_> =
    Expected { inputs: &[("position", 1)], outputs: &[("force", 1)], actions: 0 };
/// A recurrent network with scores of 9 actions.
const RECURRENT: &str = "tests/golden/onnx-foreign/epymarl_rnn.classic.onnx";

fn serve(policy: &str, domain: &TestDomain) -> Child {
    let arguments = ["serve", policy, "--domain", &domain.id, "--json"];
    sortie(&arguments).stdout(Stdio::piped()).spawn().expect("the command line starts")
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
fn what_cannot_be_served_is_refused() {
    let domain = TestDomain::new("refused");
    let serve = |more: &[&str]| output(&[&["serve", "--domain", &domain.id], more].concat());
    assert_fails(&serve(&["nothing.plan"]), 66, &["nothing.plan"]);
    let of_team = serve(&["tests/golden/plans/agent-2.0.plan"]);
    assert_fails(&of_team, 65, &["agent-2.0.plan: the policy cannot be served"]);
    assert_fails(&serve(&["README.md"]), 65, &["README.md"]);
    let fallback = serve(&[CART, "--fallback", "3"]);
    assert_fails(&fallback, 65, &["its fallback is `hold` or `zero`"]);
    let usage = serve(&[CART, "--fallback", "sleep"]);
    assert_eq!(usage.status.code(), Some(2));
    let usage = serve(&[CART, "--deadline-ms", "0"]);
    assert_eq!(usage.status.code(), Some(2));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}
