//! A policy that is served, and the programs that ask it.

mod guarded;
mod presence;

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use sortie_core::plan::{AlignedBytes, Guards, Plan};
use sortie_core::wire::{AnswerStatus, Reason};
use sortie_ipc::{
    ClientSettings, Domain, Error, Expected, Fallback, PolicyClient, PolicySchema, PolicyServer,
    RealTime, ServeCounters, ServeSettings, Stop,
};

use crate::processes::child;
use crate::toy::{self, Watchdog};

/// Roles of child processes.
pub(crate) const SERVER: &str = "policy server";
pub(crate) const CLIENT: &str = "policy client";
/// What they print once they answer, or have been answered.
const READY: &str = "at the policy";

/// A position in, a force out, and a state of 16.
const CART: &[u8] = sortie_core::include_plan!("../../../../examples/embed_c/cart.plan");
/// Two inputs, one output.
const TWO_INPUTS: &[u8] =
    sortie_core::include_plan!("../../../../tests/golden/plans/policy-2.0.plan");
const CART_SHAPE: Expected<'_> =
    Expected { inputs: &[("position", 1)], outputs: &[("force", 1)], actions: 0 };

/// Longer than any test.
const PATIENT: ClientSettings = ClientSettings {
    deadline: Some(Duration::from_secs(3600)),
    fallback: None,
    patience: Duration::from_secs(50),
    linger: None,
};
const SHORT: Duration = Duration::from_millis(5);

fn settings(fallback: Fallback) -> ServeSettings {
    ServeSettings {
        deadline: SHORT,
        fallback,
        draw: None,
        linger: None,
        real_time: RealTime::default(),
    }
}

fn schema(plan: &[u8]) -> PolicySchema {
    let schema = PolicySchema::of_plan(&Plan::load(plan).unwrap()).unwrap();
    schema.named(["position"], ["force"], ["state"])
}

/// A server in a thread of this process.
struct Serving {
    stop: Stop,
    thread: JoinHandle<ServeCounters>,
}

impl Serving {
    fn start(domain: &Domain, plan: &'static [u8], settings: &ServeSettings) -> Self {
        Self::start_with(domain, plan, settings, move |server, stop| {
            server
                .serve(
                    &Plan::load(plan).unwrap(),
                    Guards::of_plan(plan).unwrap(),
                    &mut |_| (),
                    stop,
                )
                .unwrap()
        })
    }

    fn start_with(
        domain: &Domain,
        plan: &'static [u8],
        settings: &ServeSettings,
        serve: impl FnOnce(&mut PolicyServer, &Stop) -> ServeCounters + Send + 'static,
    ) -> Self {
        let (stop, domain, settings) = (Stop::new(), domain.clone(), *settings);
        let (stops, (opened, opens)) = (stop.clone(), mpsc::channel());
        let thread = std::thread::spawn(move || {
            let mut server = PolicyServer::open(&domain, schema(plan), &settings).unwrap();
            opened.send(()).unwrap();
            serve(&mut server, &stops)
        });
        opens.recv().unwrap();
        Self { stop, thread }
    }

    fn end(self) -> ServeCounters {
        self.stop.stop();
        self.thread.join().unwrap()
    }
}

/// What child processes do.
pub(crate) fn play(role: &str, domain: &Domain, stop: &Stop) {
    if role == SERVER {
        let settings = settings(Fallback::Hold);
        let mut server = PolicyServer::open(domain, schema(CART), &settings).unwrap();
        println!("\n{READY}");
        server.serve(&Plan::load(CART).unwrap(), None, &mut |_| (), stop).unwrap();
        return;
    }
    let mut client = PolicyClient::connect(domain, &CART_SHAPE, &PATIENT).unwrap();
    assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
    println!("\n{READY}");
    while !stop.is_set() {
        client.decide(&[&[0.5]], &[]).unwrap();
    }
}

/// A child process that has said that it is ready.
fn ready(domain: &Domain, role: &str) -> Child {
    let mut child = child(domain, role).stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.map_while(Result::ok).any(|line| line == READY), "{role} has ended");
    child
}

/// A plan that is called, with a state of its own.
struct Direct {
    plan: Plan<'static>,
    arena: AlignedBytes,
    states: Vec<f32>,
}

impl Direct {
    fn new(plan: &'static [u8]) -> Self {
        let plan = Plan::load(plan).unwrap();
        let (arena, states) = (AlignedBytes::zeroed(plan.arena_bytes()), vec![0.0; plan.hidden()]);
        Self { plan, arena, states }
    }

    fn bits(&mut self, inputs: &[&[f32]], outputs: usize) -> Vec<u32> {
        let mut outputs = vec![0.0; outputs];
        let arena = self.arena.as_mut_slice();
        self.plan.respond(arena, inputs, &mut self.states, &mut [&mut outputs]).unwrap();
        bits(&outputs)
    }
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// A position that goes up and down.
fn position(step: u16) -> [f32; 1] {
    [f32::from(step * 379 % 1000) / 500.0 - 1.0]
}

#[test]
fn a_domain_of_the_longest_name_is_served_and_leaves_nothing() {
    let _watchdog = Watchdog::new();
    let domain = Domain::new(&format!("longest-name-{:011}", std::process::id())).unwrap();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
    drop(client);
    assert_eq!(serving.end().answered, 1);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn served_answers_are_those_of_a_direct_call_over_episodes() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    let mut direct = Direct::new(CART);
    for episode in 0..3 {
        if episode > 0 {
            client.begin_episode();
            direct.states.fill(0.0);
        }
        for step in 0..50 {
            let input = position(step + episode);
            let action = client.decide(&[&input], &[]).unwrap();
            assert_eq!(bits(action.outputs), direct.bits(&[&input], 1), "{episode}, {step}");
            assert_eq!((action.status, action.action), (AnswerStatus::Answered, None));
            assert!(!action.lost_state);
        }
    }
    assert_eq!(client.counters().answered, 150);
    drop(client);
    let counters = serving.end();
    assert_eq!((counters.answered, counters.sessions, counters.resets), (150, 1, 3));
    assert_eq!((counters.missed, counters.refused, counters.fallbacks), (0, 0, 0));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
    assert!(!domain.base().exists());
}

#[test]
fn several_inputs_arrive_each_in_its_place() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, TWO_INPUTS, &settings(Fallback::Hold));
    let schema = schema(TWO_INPUTS);
    let ports = |ports: &[sortie_ipc::Port]| -> Vec<(&str, usize)> {
        ports.iter().map(|port| ("", port.length)).collect()
    };
    let (inputs, outputs) = (ports(&schema.inputs), ports(&schema.outputs));
    assert!(inputs.len() > 1, "{inputs:?}");
    let expected = Expected { inputs: &inputs, outputs: &outputs, actions: schema.actions };
    let mut client = PolicyClient::connect(&domain, &expected, &PATIENT).unwrap();
    let mut direct = Direct::new(TWO_INPUTS);
    for step in 0..20 {
        let numbers = |length: usize, odd: usize| -> Vec<f32> {
            (0..length).map(|index| ((step + index * odd) % 2) as f32).collect()
        };
        let given: Vec<Vec<f32>> =
            schema.inputs.iter().zip([1, 3]).map(|(port, odd)| numbers(port.length, odd)).collect();
        let given: Vec<&[f32]> = given.iter().map(Vec::as_slice).collect();
        let available = vec![1; schema.actions];
        let action = client.decide(&given, &available).unwrap();
        assert_eq!(bits(action.outputs), direct.bits(&given, schema.outputs[0].length));
    }
    drop(client);
    serving.end();
}

#[test]
fn what_the_policy_cannot_decide_on_is_the_fallback_and_changes_no_state() {
    let _watchdog = Watchdog::new();
    for (fallback, is_held) in [(Fallback::Hold, true), (Fallback::Zero, false)] {
        let domain = toy::domain();
        let serving = Serving::start(&domain, CART, &settings(fallback));
        let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
        let mut direct = Direct::new(CART);
        let last = direct.bits(&[&[0.5]], 1);
        assert_eq!(bits(client.decide(&[&[0.5]], &[]).unwrap().outputs), last);
        let refused = client.decide(&[&[f32::NAN]], &[]).unwrap();
        assert_eq!((refused.status, refused.reason), (AnswerStatus::Fallback, Reason::NonFinite));
        assert_eq!(bits(refused.outputs), if is_held { last } else { vec![0] });
        let next = direct.bits(&[&[0.25]], 1);
        assert_eq!(bits(client.decide(&[&[0.25]], &[]).unwrap().outputs), next);
        assert_eq!((client.counters().fallbacks, client.counters().silent), (1, 0));
        drop(client);
        assert_eq!(serving.end().fallbacks, 1);
    }
}

#[test]
fn an_answer_after_the_deadline_is_late_and_the_robot_does_not_wait_for_it() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
    client.set_deadline(Duration::ZERO);
    for _ in 0..20 {
        let action = client.decide(&[&[0.5]], &[]).unwrap();
        assert_ne!(action.status, AnswerStatus::Answered);
    }
    client.set_deadline(Duration::from_secs(3600));
    assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
    let met = client.counters();
    assert_eq!(met.silent + met.late, 20);
    drop(client);
    let counters = serving.end();
    // Whatever was not overtaken was answered, and all but the first and the last of these too late.
    assert_eq!(counters.late + 2, counters.answered);
    assert_eq!(counters.answered + counters.missed, 22);
}

/// Where nobody answers, a deadline of nothing is over at once and another one longer than any test.
#[test]
fn a_client_waits_as_long_as_it_says_or_else_as_the_server_says() {
    let _watchdog = Watchdog::new();
    let long = Duration::from_secs(3600);
    for (own, of_server) in [(Some(Duration::ZERO), long), (None, Duration::ZERO)] {
        let domain = toy::domain();
        let settings = ServeSettings { deadline: of_server, ..settings(Fallback::Hold) };
        let server = PolicyServer::open(&domain, schema(CART), &settings).unwrap();
        let own = ClientSettings { deadline: own, ..PATIENT };
        let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &own).unwrap();
        assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().reason, Reason::Silence);
        drop((client, server));
    }
}

#[test]
fn a_client_that_expects_another_policy_is_refused() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    let expected = Expected { inputs: &[("position", 2)], ..CART_SHAPE };
    let refused = PolicyClient::connect(&domain, &expected, &PATIENT).err().unwrap();
    assert_eq!(refused.exit_code(), 78);
    let told = refused.to_string();
    let words = "serves another policy: input 0 is `position` [2] here, `position` [1] there";
    assert!(told.ends_with(words), "{told}");
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    for (inputs, available) in [(&[1.0, 2.0][..], &[][..]), (&[1.0], &[1])] {
        let refused = client.decide(&[inputs], available).unwrap_err();
        assert!(matches!(refused, Error::BadObservation { .. }), "{refused}");
    }
    // The one that is there keeps out a server of another policy.
    serving.end();
    let settings = settings(Fallback::Hold);
    let other = PolicyServer::open(&domain, schema(TWO_INPUTS), &settings).err().unwrap();
    assert!(matches!(other, Error::SchemaInUse { .. }), "{other}");
    let serving = Serving::start(&domain, CART, &settings);
    assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
    drop(client);
    serving.end();
}

#[test]
fn a_policy_has_one_server_and_one_client() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let impatient = ClientSettings { patience: Duration::ZERO, ..PATIENT };
    let alone = PolicyClient::connect(&domain, &CART_SHAPE, &impatient).err().unwrap();
    assert!(matches!(alone, Error::NoServer { .. }) && alone.exit_code() == 69, "{alone}");
    let action = settings(Fallback::Action(1));
    let refused = PolicyServer::open(&domain, schema(CART), &action).err().unwrap();
    assert!(refused.to_string().contains("its fallback is `hold` or `zero`"), "{refused}");
    let settings = settings(Fallback::Hold);
    let serving = Serving::start(&domain, CART, &settings);
    let client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    let second = PolicyServer::open(&domain, schema(CART), &settings).err().unwrap();
    let other = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).err().unwrap();
    for refused in [second, other] {
        assert!(matches!(refused, Error::Busy { .. }) && refused.exit_code() == 75, "{refused}");
    }
    drop(client);
    serving.end();
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn a_state_that_is_lost_is_said_also_where_the_first_answer_comes_too_late() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let settings = settings(Fallback::Hold);
    let first = Serving::start(&domain, CART, &settings);
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    client.decide(&[&[0.5]], &[]).unwrap();
    first.end();
    let ((serve, may_serve), (answered, answers)) = (mpsc::channel(), mpsc::channel());
    let next = Serving::start_with(&domain, CART, &settings, move |server, stop| {
        may_serve.recv().unwrap();
        let plan = Plan::load(CART).unwrap();
        server.serve(&plan, None, &mut |served| answered.send(served.seq).unwrap(), stop).unwrap()
    });
    client.set_deadline(Duration::ZERO);
    let silent = client.decide(&[&[0.5]], &[]).unwrap();
    assert_eq!((silent.reason, silent.lost_state), (Reason::Silence, false));
    serve.send(()).unwrap();
    assert_eq!(answers.recv(), Ok(2));
    client.set_deadline(Duration::from_secs(3600));
    for lost_state in [true, false] {
        let action = client.decide(&[&[0.5]], &[]).unwrap();
        assert_eq!((action.status, action.lost_state), (AnswerStatus::Answered, lost_state));
    }
    assert_eq!((client.counters().overdue, client.counters().lost_states), (1, 1));
    drop(client);
    next.end();
}

#[test]
fn a_robot_outlives_a_server_that_is_killed_and_goes_on_with_the_next() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut server = ready(&domain, SERVER);
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    for round in 0..3 {
        let last = client.decide(&[&[0.5]], &[]).unwrap();
        assert_eq!(last.status, AnswerStatus::Answered);
        assert_eq!(last.lost_state, round > 0, "in round {round}");
        let last = bits(last.outputs);
        server.kill().unwrap();
        server.wait().unwrap();
        client.set_deadline(SHORT);
        for _ in 0..5 {
            let held = client.decide(&[&[0.25]], &[]).unwrap();
            assert_eq!((held.status, held.reason), (AnswerStatus::Fallback, Reason::Silence));
            assert_eq!(bits(held.outputs), last);
        }
        client.set_deadline(Duration::from_secs(3600));
        server = ready(&domain, SERVER);
    }
    let answer = client.decide(&[&[0.5]], &[]).unwrap();
    assert!(answer.lost_state);
    assert_eq!(bits(answer.outputs), Direct::new(CART).bits(&[&[0.5]], 1));
    let next = client.decide(&[&[0.5]], &[]).unwrap();
    assert!(!next.lost_state);
    assert_eq!(client.counters().lost_states, 3);
    drop(client);
    server.kill().unwrap();
    server.wait().unwrap();
    // What all of them left goes with whoever comes next.
    drop(domain.enter().unwrap());
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn a_server_outlives_robots_that_are_killed() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    // More of them than there are places.
    for _ in 0..6 {
        let mut robot = ready(&domain, CLIENT);
        robot.kill().unwrap();
        robot.wait().unwrap();
    }
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    let mut direct = Direct::new(CART);
    for step in 0..20 {
        let input = position(step);
        let action = client.decide(&[&input], &[]).unwrap();
        assert_eq!(bits(action.outputs), direct.bits(&[&input], 1));
    }
    drop(client);
    assert_eq!(serving.end().sessions, 7);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
