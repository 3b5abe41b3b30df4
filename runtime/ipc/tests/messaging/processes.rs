//! Whole teams: in one thread, and as processes. A child is this test binary again, running the
//! test `child_process` with its role in the environment.

use std::process::Command;
use std::time::Duration;

use sortie_core::roles::Counters;
use sortie_ipc::{
    Children, Domain, Error, InProcess, ProcessSettings, Stop, WorldSettings, allocator_process,
    run_in_process, runner_process, world_process,
};

use crate::toy::{self, DecisionLog, ToyAllocator, ToyPolicy, ToyWorld};

const ROLE: &str = "SORTIE_TEST_ROLE";
const DOMAIN: &str = "SORTIE_TEST_DOMAIN";
const PARENT: &str = "SORTIE_TEST_PARENT";

fn settings(episodes: u32) -> WorldSettings {
    WorldSettings { allocator: true, episodes: Some(episodes), ..WorldSettings::default() }
}

/// A process of the team: `allocator`, or the agents of a runner as `0,2`.
fn child(domain: &Domain, role: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["processes::child_process", "--exact", "--nocapture"])
        .env(ROLE, role)
        .env(DOMAIN, domain.id())
        .env(PARENT, std::process::id().to_string())
        .stdout(std::process::Stdio::null());
    command
}

#[test]
fn child_process() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let domain = Domain::new(&std::env::var(DOMAIN).unwrap()).unwrap();
    let parent = std::env::var(PARENT).unwrap().parse().unwrap();
    let settings = ProcessSettings { parent: Some(parent), ..ProcessSettings::default() };
    let stop = Stop::on_signals().unwrap();
    let contract = toy::contract();
    let ended = if role == "allocator" {
        allocator_process(&domain, &contract, &mut ToyAllocator, &settings, &stop)
    } else {
        let agents: Vec<u16> = role.split(',').map(|agent| agent.parse().unwrap()).collect();
        runner_process(&domain, &contract, &agents, &mut ToyPolicy, &settings, &stop)
    };
    match ended {
        Ok(_) => {}
        Err(error) => std::process::exit(error.exit_code().into()),
    }
}

fn run_processes(
    domain: &Domain,
    roles: &[&str],
    settings: &WorldSettings,
    log: &mut DecisionLog,
) -> Result<Counters, Error> {
    let start_team = |children: &mut Children| {
        roles.iter().try_for_each(|role| children.spawn(*role, &mut child(domain, role)))
    };
    let contract = toy::contract();
    let mut world = ToyWorld::new();
    world_process(domain, &contract, &mut world, settings, start_team, log, &Stop::new())
}

fn run_in_one_thread(episodes: u32) -> DecisionLog {
    let mut log = DecisionLog::default();
    let team = InProcess {
        world: &mut ToyWorld::new(),
        policy: &mut ToyPolicy,
        allocator: Some(&mut ToyAllocator),
    };
    run_in_process(team, &toy::contract(), &settings(episodes), &mut log, &Stop::new()).unwrap();
    log
}

#[test]
fn processes_decide_exactly_as_one_thread_does() {
    let alone = run_in_one_thread(4);
    for roles in [&["allocator", "0,1,2"][..], &["0", "1", "2", "allocator"]] {
        let domain = toy::domain();
        let mut log = DecisionLog::default();
        run_processes(&domain, roles, &settings(4), &mut log).unwrap();
        toy::assert_same_log(&log, &alone);
        assert_eq!(toy::leftovers(&domain), [""; 0]);
    }
    assert_eq!(alone.episodes, 4);
}

#[test]
fn a_runner_that_never_comes_is_named() {
    let domain = toy::domain();
    let mut log = DecisionLog::default();
    let impatient = WorldSettings { join_patience: Duration::from_millis(300), ..settings(1) };
    let error = run_processes(&domain, &["allocator", "0,2"], &impatient, &mut log).unwrap_err();
    assert_eq!(error.to_string(), "nobody has joined for agent 1");
    assert_eq!(error.exit_code(), 69);
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
