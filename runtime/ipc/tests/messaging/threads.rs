//! Whole teams in the threads of one process: each link that can be one decides as one thread does.

use std::time::Duration;

use sortie_core::World;
use sortie_core::link::{AgentLink, AllocLink, Bell, Clock, WorldLink};
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Identity, Poll, RunnerOptions, RunnerRole, WorldOptions,
    WorldRole,
};
use sortie_core::wire::FrameFormat;
use sortie_ipc::{
    BellKind, DomainFacts, IntraProcess, IoxAgent, IoxAllocator, IoxWorld, LinkSetup, Threads,
};

use crate::processes::run_in_one_thread;
use crate::toy::{self, DecisionLog, ToyAllocator, ToyPolicy, ToyWorld, Watchdog};

const EPISODES: u32 = 10;
const HEARTBEAT_NS: u64 = 100_000_000;

fn format() -> FrameFormat {
    DomainFacts::new(&toy::contract(), toy::SHAPE).format().unwrap()
}

/// Polls a role until it ends.
fn drive<L: Bell + Clock>(mut link: L, mut poll: impl FnMut(&mut L) -> Poll) {
    loop {
        let token = link.token();
        match poll(&mut link) {
            Poll::Ended => return,
            Poll::Again | Poll::Answered => {}
            Poll::Wait { until_ns } => {
                let until_ns = until_ns.min(link.now_ns() + HEARTBEAT_NS);
                link.wait_until(token, until_ns);
            }
        }
    }
}

fn act(mut link: impl AgentLink, agents: u64) {
    let contract = toy::contract();
    let mut role = RunnerRole::new(RunnerOptions {
        format: format(),
        identity: Identity::new(agents as u32, "runner"),
        agents,
        subtasks: contract.subtasks,
        decision_interval: contract.decision_interval,
        period_ns: 0,
        safe_action: contract.safe_action,
    });
    role.join(&mut link).unwrap();
    drive(link, |link| role.poll(link, &mut ToyPolicy).unwrap());
}

fn allocate(mut link: impl AllocLink) {
    let mut role = AllocatorRole::new(AllocatorOptions {
        format: format(),
        identity: Identity::new(200, "allocator"),
        decision_interval: toy::contract().decision_interval,
    });
    role.lead(1);
    role.join(&mut link).unwrap();
    drive(link, |link| role.poll(link, &mut ToyAllocator).unwrap());
}

fn decide(link: impl WorldLink) -> DecisionLog {
    let (mut world, mut log) = (ToyWorld::new(), DecisionLog::default());
    assert_eq!(world.shape(), toy::SHAPE);
    let contract = toy::contract();
    let mut role = WorldRole::new(WorldOptions {
        format: format(),
        identity: Identity::new(1, "world"),
        term: 1,
        required: 0b111,
        allocator: true,
        strict: true,
        pipelined: false,
        period_ns: 0,
        absent_after: 3,
        absent: 0,
        join_patience_ns: u64::MAX,
        patience_ns: 0,
        decision_interval: contract.decision_interval,
        safe_action: contract.safe_action,
        episodes: Some(EPISODES),
        tick_interval_ns: 0,
    });
    drive(link, |link| role.poll(link, &mut world, &mut log).unwrap());
    log
}

#[test]
fn threads_decide_exactly_as_one_thread_does() {
    let _watchdog = Watchdog::new();
    let team = Threads::new(&format());
    let log = std::thread::scope(|scope| {
        let (one, other, allocator) = (team.agent(), team.agent(), team.allocator());
        scope.spawn(move || act(one, 0b101));
        scope.spawn(move || act(other, 0b010));
        scope.spawn(move || allocate(allocator));
        decide(team.world())
    });
    toy::assert_same_log(&log, &run_in_one_thread(EPISODES));
}

#[test]
fn links_within_a_process_decide_exactly_as_one_thread_does() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let setup = |name| LinkSetup {
        domain: &domain,
        format: format(),
        name,
        bell: BellKind::Event,
        linger: Duration::ZERO,
    };
    // Opened by the thread that uses them, once the world is there.
    let world = IoxWorld::<IntraProcess>::open(&setup("world")).unwrap();
    let log = std::thread::scope(|scope| {
        for agents in [0b101, 0b010] {
            scope.spawn(move || {
                act(IoxAgent::<IntraProcess>::open(&setup("agent")).unwrap(), agents)
            });
        }
        scope.spawn(|| allocate(IoxAllocator::<IntraProcess>::open(&setup("allocator")).unwrap()));
        decide(world)
    });
    toy::assert_same_log(&log, &run_in_one_thread(EPISODES));
    // Nothing of it is outside of this process.
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
