//! How a server is looked after, with any engine; and clients that do more than ask.

use rustix::process::{Pid, Signal, kill_process};
use sortie_core::plan::Plan;
use sortie_core::wire::{AnswerStatus, Command, ControlStatus, Reason, Role};
use sortie_ipc::{
    Answer, AnyThread, ClientSettings, Domain, Engine, Error, Expected, Fallback, Finding, Order,
    PolicyClient, Severity, Stop, control, examine,
};

use super::{CART, CART_SHAPE, PATIENT, SERVER, Serving, ready, schema, settings};
use crate::toy::{self, Watchdog};

/// What the server of a domain answers.
fn told(domain: &Domain, order: Order) -> Vec<Answer> {
    control(domain, &order).unwrap()
}

#[test]
fn a_server_says_who_it_is_and_ends_when_it_is_told() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    for _ in 0..3 {
        client.decide(&[&[0.5]], &[]).unwrap();
    }
    let [answer] = told(&domain, Order::new(Command::Info))[..] else { panic!("one server") };
    let process = answer.process;
    assert_eq!((process.role, process.pid), (Role::Runner, std::process::id()));
    assert_eq!((process.serves, process.is_graph, answer.tick), (true, false, 3));
    let source = Plan::load(CART).unwrap().header().source;
    assert_eq!(process.model, source[..16]);
    // What concerns teams does not concern it, nor what another process is told.
    for command in [Command::Pause, Command::ResetEpisode, Command::StepDown] {
        assert_eq!(told(&domain, Order::new(command)), []);
    }
    let other = Order { process: Some(1), ..Order::new(Command::ShutDown) };
    assert_eq!(told(&domain, other), []);
    let reload = told(&domain, Order::new(Command::PrepareBundle).with_text("other"));
    assert_eq!(reload[0].status, Some(ControlStatus::NotSupported));
    assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
    let last = told(&domain, Order::new(Command::ShutDown));
    assert_eq!(last[0].status, Some(ControlStatus::Done));
    assert_eq!(serving.thread.join().unwrap().answered, 4);
    assert_eq!(told(&domain, Order::new(Command::Info)), []);
    drop(client);
    assert!(matches!(control(&domain, &Order::new(Command::Info)), Err(Error::NoWorld { .. })));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// Examines a domain until it is found to be so: on a loaded machine a server may be late.
fn await_finding(domain: &Domain, is_so: impl Fn(&Finding) -> bool) -> Finding {
    loop {
        if let Some(found) = examine(domain).unwrap().into_iter().find(&is_so) {
            return found;
        }
    }
}

#[test]
fn the_doctor_sees_a_server_and_misses_one_that_was_stopped_or_killed() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut server = ready(&domain, SERVER);
    let is = |check: &'static str, severity: Severity| {
        move |found: &Finding| (found.check, found.severity) == (check, severity)
    };
    let found = await_finding(&domain, is("server", Severity::Fine)).found;
    let words = format!("process {}, model ", server.id());
    assert!(found.starts_with(&words) && found.contains(", 0 answers, 0 late"), "{found}");
    let policy = await_finding(&domain, is("policy", Severity::Fine)).found;
    let hash = schema(CART).hash();
    let words =
        format!("position [1] -> force [1], schema {hash:016x}, deadline 5 ms, fallback hold");
    assert_eq!(policy, words);
    assert_eq!(await_finding(&domain, is("robot", Severity::Fine)).found, "none asks just now");
    assert!(!examine(&domain).unwrap().iter().any(|found| found.check == "world"));
    // Somebody asks what it cannot decide on.
    let (stop, asking) = (Stop::new(), domain.clone());
    let stops = stop.clone();
    let robot = std::thread::spawn(move || {
        let mut client = PolicyClient::connect(&asking, &CART_SHAPE, &PATIENT).unwrap();
        while !stops.is_set() {
            client.decide(&[&[f32::NAN]], &[]).unwrap();
        }
    });
    let found = await_finding(&domain, is("robot", Severity::Warning)).found;
    assert!(found.ends_with("late, missed, refused or fallbacks"), "{found}");
    stop.stop();
    robot.join().unwrap();
    let client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    // One that stands still is missed as one that is dead.
    let stopped = Pid::from_raw(server.id() as i32).unwrap();
    kill_process(stopped, Signal::STOP).unwrap();
    await_finding(&domain, is("server", Severity::Problem));
    kill_process(stopped, Signal::CONT).unwrap();
    await_finding(&domain, is("server", Severity::Fine));
    server.kill().unwrap();
    server.wait().unwrap();
    let lost = await_finding(&domain, is("server", Severity::Problem));
    assert!(lost.advice.contains("sortie serve"), "{}", lost.advice);
    drop(client);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// Says how far the position is from the last one, and does not decide left of 0.
struct Difference;

impl Engine for Difference {
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason> {
        let position = inputs[0][0];
        if position < 0.0 {
            return Err(Reason::Policy);
        }
        outputs[0][0] = position - states[0];
        states[0] = position;
        Ok(())
    }

    fn model(&self) -> [u8; 16] {
        [7; 16]
    }

    fn is_graph(&self) -> bool {
        true
    }
}

#[test]
fn another_engine_decides_behind_the_same_schema_and_is_told_apart() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start_with(&domain, CART, &settings(Fallback::Zero), |server, stop| {
        server.serve_with(&mut Difference, None, &mut |_| (), stop).unwrap()
    });
    let mut client = PolicyClient::connect(&domain, &CART_SHAPE, &PATIENT).unwrap();
    let mut force = |position: f32| client.decide(&[&[position]], &[]).unwrap().outputs[0];
    assert_eq!([force(1.0), force(4.0)], [1.0, 3.0]);
    let refused = client.decide(&[&[-1.0]], &[]).unwrap();
    assert_eq!((refused.status, refused.reason), (AnswerStatus::Fallback, Reason::Policy));
    assert_eq!(refused.outputs, [0.0]);
    assert_eq!(client.decide(&[&[6.0]], &[]).unwrap().outputs, [2.0], "the state was kept");
    client.begin_episode();
    assert_eq!(client.decide(&[&[6.0]], &[]).unwrap().outputs, [6.0]);
    let [answer] = told(&domain, Order::new(Command::Info))[..] else { panic!("one server") };
    assert_eq!((answer.process.model, answer.process.is_graph), ([7; 16], true));
    let server =
        await_finding(&domain, |found| (found.check, found.severity) == ("server", Severity::Fine));
    assert!(server.found.contains("model 07070707, runs the graph: allocates"), "{}", server.found);
    drop(client);
    serving.end();
}

#[test]
fn a_client_goes_from_thread_to_thread_and_its_wait_can_be_ended() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    let action = ClientSettings { fallback: Some(Fallback::Action(1)), ..PATIENT };
    let refused = PolicyClient::connect(&domain, &CART_SHAPE, &action).err().unwrap();
    assert!(refused.to_string().contains("its fallback is `hold` or `zero`"), "{refused}");
    let mut client = PolicyClient::connect_for_threads(&domain, &PATIENT).unwrap();
    assert_eq!(client.schema(), &schema(CART));
    client.schema().check(&domain, &CART_SHAPE).unwrap();
    let other = Expected { actions: 2, ..CART_SHAPE };
    assert_eq!(client.schema().check(&domain, &other).unwrap_err().exit_code(), 78);
    let answered = |client: &mut PolicyClient<AnyThread>| {
        client.decide(&[&[0.5]], &[]).unwrap().status == AnswerStatus::Answered
    };
    assert!(answered(&mut client));
    let moved = std::thread::spawn(move || {
        assert_eq!(client.decide(&[&[0.5]], &[]).unwrap().status, AnswerStatus::Answered);
        client
    });
    let mut client = moved.join().unwrap();
    serving.end();
    let mut asked = 0;
    let ended = client.decide_while(&[&[0.5]], &[], &mut || {
        asked += 1;
        asked < 3
    });
    assert!(matches!(ended, Err(Error::Interrupted)));
    assert_eq!(asked, 3);
    let serving = Serving::start(&domain, CART, &settings(Fallback::Hold));
    assert!(answered(&mut client));
    drop(client);
    serving.end();
}
