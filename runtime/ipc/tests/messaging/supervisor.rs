//! Supervised teams of real processes, which are killed, stopped and continued.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{AllocMsg, Role};
use sortie_ipc::{
    Charge, Domain, Error, RestartPolicy, Stop, SupervisorEvent, WorldSettings, supervise,
    world_process,
};

use crate::processes::child;
use crate::toy::{self, ToyWorld, Watchdog};

/// What the supervisor told, by charge.
#[derive(Default)]
struct Told {
    /// Process ids in the order of their starts.
    started: BTreeMap<String, Vec<u32>>,
    leaders: Vec<u32>,
    silent: Vec<u32>,
}

impl Told {
    fn note(&mut self, event: &SupervisorEvent<'_>) {
        match *event {
            SupervisorEvent::Started { name, pid } => {
                self.started.entry(name.to_string()).or_default().push(pid);
            }
            SupervisorEvent::Leads { pid, .. } => self.leaders.push(pid),
            SupervisorEvent::LeaderSilent { pid, .. } => self.silent.push(pid),
            SupervisorEvent::Ended { .. }
            | SupervisorEvent::Joined { .. }
            | SupervisorEvent::StandsBy { .. } => {}
        }
    }
}

fn charge(name: &str, role: Role, agents: u64, mut command: Command) -> Charge {
    command.stdout(Stdio::null());
    Charge { name: name.to_string(), role, agents, command }
}

fn charges(domain: &Domain) -> Vec<Charge> {
    let charge =
        |name: &str, role, agents, command| charge(name, role, agents, child(domain, command));
    vec![
        charge("runner 0,2", Role::Runner, 0b101, "0,2"),
        charge("runner 1", Role::Runner, 0b010, "1"),
        charge("allocator 0", Role::Allocator, 0, "allocator"),
        charge("allocator 1", Role::Allocator, 0, "allocator"),
    ]
}

/// Plays in this thread with a supervised team until `observer` says that it is enough.
fn play<O: WorldObserver>(domain: &Domain, observer: &mut O, enough: &Stop, told: &Mutex<Told>) {
    let settings = WorldSettings {
        allocator: true,
        strict: false,
        period: Duration::from_millis(4),
        ..WorldSettings::default()
    };
    let over = Stop::new();
    std::thread::scope(|scope| {
        let (ended, policy) =
            (over.clone(), RestartPolicy { immediate: Duration::ZERO, ..Default::default() });
        let kept = scope.spawn(move || {
            let mut tell = |event: &SupervisorEvent<'_>| told.lock().unwrap().note(event);
            supervise(domain, charges(domain), &policy, &mut tell, &ended)
        });
        let mut world = ToyWorld::new();
        let contract = toy::contract();
        let start = |_: &mut _| Ok(());
        let played =
            world_process(domain, &contract, &mut world, &settings, start, observer, enough);
        assert!(matches!(played, Err(Error::Interrupted)), "{played:?}");
        // A process that has just been started again did not hear the world's goodbye.
        over.stop();
        let kept = kept.join().unwrap();
        assert!(matches!(kept, Ok(_) | Err(Error::Interrupted)), "{kept:?}");
    })
}

fn send(pid: u32, signal: Signal) {
    kill_process(Pid::from_raw(pid as i32).unwrap(), signal).unwrap();
}

/// Stops a runner, and lets it go on when its agent has missed some ticks.
struct Pause {
    pid: Option<u32>,
    missed: u32,
    /// Tick of the first answer after the pause.
    back: Option<u64>,
    enough: Stop,
}

impl WorldObserver for Pause {
    fn tick(&mut self, report: &TickReport<'_>) {
        let answer = report.answers().find(|answer| answer.agent == 1);
        match (self.pid, answer) {
            (None, Some(answer)) if report.step > 5 => {
                self.pid = Some(answer.runner);
                send(answer.runner, Signal::STOP);
            }
            (Some(pid), None) => {
                self.missed += 1;
                // Silent for long enough to be vacant; agents that are absent are not silent.
                if self.missed == 20 {
                    send(pid, Signal::CONT);
                }
            }
            (Some(pid), Some(answer)) if self.missed >= 20 && self.back.is_none() => {
                assert_eq!((answer.runner, answer.tick), (pid, report.tick));
                self.back = Some(answer.tick);
                self.enough.stop();
            }
            _ => {}
        }
    }
}

#[test]
fn a_stopped_runner_is_not_waited_for_and_comes_back_to_the_newest_frame() {
    let _watchdog = Watchdog::new();
    let (domain, told, enough) = (toy::domain(), Mutex::default(), Stop::new());
    let mut pause = Pause { pid: None, missed: 0, back: None, enough: enough.clone() };
    play(&domain, &mut pause, &enough, &told);
    let told = told.into_inner().unwrap();
    assert!(told.started.values().all(|pids| pids.len() == 1));
    assert!(pause.back.is_some());
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// Stops the leading allocator; the supervisor has to kill it.
struct StopLeader<'a> {
    told: &'a Mutex<Told>,
    stopped: Option<u32>,
    terms: Vec<u32>,
    enough: Stop,
}

impl WorldObserver for StopLeader<'_> {
    fn allocated(&mut self, allocation: &AllocMsg) {
        self.terms.push(allocation.term);
        self.terms.dedup();
        if self.terms.len() == 2 {
            self.enough.stop();
        }
    }

    fn tick(&mut self, _report: &TickReport<'_>) {
        let leader = self.told.lock().unwrap().leaders.first().copied();
        if let (None, Some(leader)) = (self.stopped, leader) {
            self.stopped = Some(leader);
            send(leader, Signal::STOP);
        }
    }
}

#[test]
fn a_leader_that_is_stopped_is_killed_and_the_standby_takes_over() {
    let _watchdog = Watchdog::new();
    let (domain, told, enough) = (toy::domain(), Mutex::default(), Stop::new());
    let mut watch =
        StopLeader { told: &told, stopped: None, terms: Vec::new(), enough: enough.clone() };
    play(&domain, &mut watch, &enough, &told);
    assert_eq!(watch.terms, [1, 2]);
    assert_eq!(told.lock().unwrap().silent, [watch.stopped.unwrap()]);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

fn supervise_quietly(domain: &Domain, charges: Vec<Charge>, policy: &RestartPolicy) -> Error {
    supervise(domain, charges, policy, &mut |_| {}, &Stop::new()).unwrap_err()
}

#[test]
fn a_process_that_dies_at_once_is_given_up() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let policy = RestartPolicy { give_up_after: 4, ..RestartPolicy::default() };
    let dies = charge("a runner", Role::Runner, 1, Command::new("false"));
    let error = supervise_quietly(&domain, vec![dies], &policy);
    let told =
        "a runner ended with exit code 1, for the 4th time in a row; it is not started again";
    assert_eq!((error.to_string().as_str(), error.exit_code()), (told, 69));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

#[test]
fn an_exit_code_that_would_come_again_is_given_up_at_once() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut misfit = Command::new("sh");
    misfit.args(["-c", "exit 78"]);
    let charges = vec![charge("a runner", Role::Runner, 1, misfit)];
    let error = supervise_quietly(&domain, charges, &RestartPolicy::default());
    assert_eq!(
        (error.to_string().as_str(), error.exit_code()),
        ("a runner ended with exit code 78", 78)
    );
}

#[test]
fn a_world_that_fails_and_is_not_started_again_is_no_success() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let failing = |name: &str, role| {
        let mut command = Command::new("sh");
        command.args(["-c", "exit 3"]);
        charge(name, role, 1, command)
    };
    let policy = RestartPolicy { never: true, ..RestartPolicy::default() };
    let error = supervise_quietly(&domain, vec![failing("the world", Role::World)], &policy);
    assert!(matches!(&error, Error::Child { name, .. } if name == "the world"), "{error}");
    // Others may be missed.
    let done = supervise(
        &domain,
        vec![failing("a runner", Role::Runner)],
        &policy,
        &mut |_| (),
        &Stop::new(),
    );
    assert_eq!(done.expect("nobody is left").deaths, 1);
}

#[test]
fn what_was_killed_all_at_once_starts_again_twenty_times() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let spawn = |role: &str| child(&domain, role).spawn().unwrap();
    for round in 0..20 {
        let mut team = ["world without team", "allocator", "0,2", "1"].map(spawn);
        // Every round strikes at another moment of the start.
        let until = std::time::Instant::now() + Duration::from_millis(5 * round);
        while std::time::Instant::now() < until {
            std::thread::yield_now();
        }
        team.iter_mut().for_each(|child| child.kill().unwrap());
        for child in &mut team {
            child.wait().unwrap();
        }
    }
    let enough = Stop::new();
    struct Few(Stop);
    impl WorldObserver for Few {
        fn tick(&mut self, report: &TickReport<'_>) {
            if report.step == 5 {
                self.0.stop();
            }
        }
    }
    let told = Mutex::default();
    play(&domain, &mut Few(enough.clone()), &enough, &told);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
