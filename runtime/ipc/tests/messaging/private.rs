//! Teams whose agents get their own frames only: over every link, and as processes.

use std::cell::RefCell;
use std::time::Duration;

use sortie_core::link::{
    AgentLink, AllocLink, Direct, DirectCursor, FrameBlock, FrameRx, PrivateFrames,
};
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Counters, Identity, Poll, RunnerOptions, RunnerRole,
    WorldOptions, WorldRole,
};
use sortie_core::wire::{FrameFormat, FrameLayout, FrameView};
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_ipc::{
    BellKind, Domain, DomainFacts, Error, InProcess, IntraProcess, IoxAgent, IoxAllocator,
    IoxWorld, LinkSetup, MonotonicClock, ProcessSettings, Stop, Threads, WorldSettings,
    run_in_process, runner_process,
};

use crate::processes::{run_processes, settings};
use crate::toy::{self, DecisionLog, SHAPE, ToyAllocator, ToyWorld, Watchdog};

/// The role of a child with private frames, before its agents.
pub(crate) const PRIVATE: &str = "private ";
/// Ticks of a comparison.
const EPISODES: u32 = 40;

/// As the toy's, but blind to an entity's number, which no private frame tells: utilities depend on what is seen, on
/// last actions, and on the order in which the floats of what is seen are added.
pub(crate) struct Nameless;

impl Policy for Nameless {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let row = |entity: usize| {
            let first = entity * observation.stride;
            &observation.rows[first..first + SHAPE.features]
        };
        let own = row(observation.self_index).iter().sum::<f32>();
        if own < 0.5 {
            return Err(DecideError::NonFinite);
        }
        for (action, utility) in utilities.iter_mut().enumerate() {
            *utility = own * action as f32;
            for (place, entity) in (1..).zip(observation.visible.iter()) {
                let last = observation.last_actions.get(entity).copied().unwrap_or(u16::MAX);
                let weight = (place * (action + 1)) as f32 + f32::from(last) / 65_536.0;
                *utility += row(entity).iter().map(|x| (x * weight).sin()).sum::<f32>();
            }
        }
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = [0.0; SHAPE.actions];
        self.utilities(observation, &mut utilities)?;
        let available = utilities.iter().zip(observation.available).enumerate();
        let (action, utility) = available
            .filter(|(_, (_, code))| **code != 0)
            .max_by(|(_, (one, _)), (_, (other, _))| one.total_cmp(other))
            .map(|(action, (utility, _))| (action, *utility))
            .ok_or(DecideError::NoAvailableAction)?;
        Ok(Decision { action: action as u16, utility })
    }
}

/// What a child does.
pub(crate) fn act(
    role: &str,
    domain: &Domain,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    let list = role.trim_start_matches(PRIVATE).trim_start_matches("shared ");
    let agents: Vec<u16> = list.split(',').map(|agent| agent.parse().unwrap()).collect();
    let settings = ProcessSettings { private: !role.contains("shared"), ..*settings };
    runner_process(domain, &toy::contract(), &agents, &mut Nameless, &settings, stop)
}

/// The team with one frame for all, in one thread.
fn shared() -> DecisionLog {
    let mut log = DecisionLog::default();
    let team = InProcess {
        world: &mut ToyWorld::new(),
        policy: &mut Nameless,
        allocator: Some(&mut ToyAllocator),
    };
    run_in_process(team, &toy::contract(), &settings(EPISODES), &mut log, &Stop::new()).unwrap();
    log
}

fn world_role(format: FrameFormat) -> WorldRole {
    let contract = toy::contract();
    WorldRole::new(WorldOptions {
        format,
        identity: Identity::new(1, "world"),
        term: 1,
        required: format.layout.every_agent(),
        allocator: true,
        strict: true,
        pipelined: false,
        join_patience_ns: 10_000_000_000,
        period_ns: 0,
        patience_ns: 0,
        absent_after: 3,
        absent: 0,
        decision_interval: contract.decision_interval,
        safe_action: contract.safe_action,
        episodes: Some(EPISODES),
        tick_interval_ns: 0,
    })
}

fn runner_role(format: FrameFormat, agent: usize) -> RunnerRole {
    let contract = toy::contract();
    let layout = FrameLayout::private(SHAPE, agent).unwrap();
    RunnerRole::new(RunnerOptions {
        format: FrameFormat { layout, ..format },
        identity: Identity::new(10 + agent as u32, "runner"),
        agents: 1 << agent,
        subtasks: true,
        decision_interval: contract.decision_interval,
        period_ns: 0,
        safe_action: contract.safe_action,
    })
}

fn allocator_role(format: FrameFormat) -> AllocatorRole {
    AllocatorRole::new(AllocatorOptions {
        format,
        identity: Identity::new(99, "allocator"),
        decision_interval: toy::contract().decision_interval,
    })
}

/// Plays a team of which everybody gets a turn with the own link, the first of which is to join.
struct Turns<W, R, A> {
    world: W,
    runner: R,
    allocator: A,
}

impl<W, R, A> Turns<W, R, A>
where
    W: FnMut(&mut WorldRole, &mut ToyWorld, &mut DecisionLog) -> Poll,
    R: FnMut(usize, &mut RunnerRole, bool) -> Poll,
    A: FnMut(&mut AllocatorRole, bool) -> Poll,
{
    fn play(mut self, format: FrameFormat) -> DecisionLog {
        let (mut world, mut log) = (ToyWorld::new(), DecisionLog::default());
        let mut world_role = world_role(format);
        let mut runners: Vec<_> = (0..3).map(|agent| runner_role(format, agent)).collect();
        let mut allocator = allocator_role(format);
        allocator.lead(1);
        let mut is_first = true;
        while (self.world)(&mut world_role, &mut world, &mut log) != Poll::Ended {
            for (agent, runner) in runners.iter_mut().enumerate() {
                (self.runner)(agent, runner, is_first);
            }
            (self.allocator)(&mut allocator, is_first);
            is_first = false;
        }
        assert_eq!(world_role.counters().bad_messages, 0);
        for runner in &runners {
            assert_eq!((runner.counters().bad_messages, runner.counters().frame_gaps), (0, 0));
        }
        log
    }
}

/// A runner's turn.
fn turn(role: &mut RunnerRole, link: &mut impl AgentLink, joins: bool) -> Poll {
    if joins {
        role.join(link).unwrap();
    }
    let polled = role.poll(link, &mut Nameless).unwrap();
    check_kept(link);
    polled
}

/// An allocator's turn.
fn allocate(role: &mut AllocatorRole, link: &mut impl AllocLink, joins: bool) -> Poll {
    if joins {
        role.join(link).unwrap();
    }
    role.poll(link, &mut ToyAllocator).unwrap()
}

/// What a private link keeps shows one agent, and rows of nothing but what it sees.
fn check_kept(link: &impl FrameRx) {
    let Some(frame) = link.frame() else { return };
    let agent = usize::from(u16::from_le_bytes([frame.payload[12], frame.payload[13]]));
    let layout = FrameLayout::private(SHAPE, agent).unwrap();
    let format = FrameFormat { layout, ..format() };
    let view = FrameView::new(frame.header, frame.payload, &format).unwrap();
    let rows = view.present().contains(agent).then(|| 1 + view.observable(agent).len());
    let is_empty = |row: &[f32]| row.iter().all(|feature| feature.to_bits() == 0);
    assert!(view.rows().chunks(view.stride()).skip(rows.unwrap_or(0)).all(is_empty));
}

fn format() -> FrameFormat {
    DomainFacts::new(&toy::contract(), SHAPE).format().unwrap()
}

fn memory() -> Vec<FrameBlock> {
    vec![FrameBlock::zeroed(); PrivateFrames::blocks(SHAPE).unwrap()]
}

#[test]
fn private_frames_of_one_thread_lead_to_the_decisions_of_shared_ones() {
    let mut blocks = vec![FrameBlock::zeroed(); format().layout.payload_bytes() / 64];
    let team = RefCell::new(Direct::new(&mut blocks, &MonotonicClock));
    let [mut world, mut allocator] = [DirectCursor::default(); 2];
    let mut memories = [memory(), memory(), memory()];
    let mut frames: Vec<_> = memories
        .iter_mut()
        .enumerate()
        .map(|(agent, memory)| PrivateFrames::new(&format(), agent, memory).unwrap())
        .collect();
    let mut cursors = [DirectCursor::default(); 3];
    let log = Turns {
        world: |role: &mut WorldRole, toy: &mut ToyWorld, log: &mut DecisionLog| {
            role.poll(&mut team.borrow_mut().world(&mut world), toy, log).unwrap()
        },
        runner: |agent: usize, role: &mut RunnerRole, joins| {
            let mut team = team.borrow_mut();
            turn(role, &mut frames[agent].over(team.agent(&mut cursors[agent])), joins)
        },
        allocator: |role: &mut AllocatorRole, joins| {
            allocate(role, &mut team.borrow_mut().allocator(&mut allocator), joins)
        },
    };
    toy::assert_same_log(&log.play(format()), &shared());
}

#[test]
fn private_frames_of_threads_lead_to_the_decisions_of_shared_ones() {
    let team = Threads::new(&format());
    let (mut world, mut allocator) = (team.world(), team.allocator());
    let mut memories = [memory(), memory(), memory()];
    let mut frames: Vec<_> = memories
        .iter_mut()
        .enumerate()
        .map(|(agent, memory)| PrivateFrames::new(&format(), agent, memory).unwrap())
        .collect();
    let mut links: Vec<_> = frames.iter_mut().map(|frames| frames.over(team.agent())).collect();
    let log = Turns {
        world: |role: &mut WorldRole, toy: &mut ToyWorld, log: &mut DecisionLog| {
            role.poll(&mut world, toy, log).unwrap()
        },
        runner: |agent: usize, role: &mut RunnerRole, joins| turn(role, &mut links[agent], joins),
        allocator: |role: &mut AllocatorRole, joins| allocate(role, &mut allocator, joins),
    };
    toy::assert_same_log(&log.play(format()), &shared());
}

#[test]
fn private_frames_of_services_lead_to_the_decisions_of_shared_ones() {
    let _watchdog = Watchdog::new();
    let membership = toy::domain().enter().unwrap();
    let (bell, linger) = (BellKind::Event, Duration::ZERO);
    let setup =
        |name| LinkSetup { domain: membership.domain(), format: format(), name, bell, linger };
    let mut world = IoxWorld::<IntraProcess>::open_private(&setup("world"), true).unwrap();
    let mut allocator = IoxAllocator::<IntraProcess>::open(&setup("allocator")).unwrap();
    let open = |agent| IoxAgent::<IntraProcess>::open_private(&setup("agent"), agent).unwrap();
    let mut links: Vec<_> = (0..3).map(open).collect();
    let log = Turns {
        world: |role: &mut WorldRole, toy: &mut ToyWorld, log: &mut DecisionLog| {
            role.poll(&mut world, toy, log).unwrap()
        },
        runner: |agent: usize, role: &mut RunnerRole, joins| turn(role, &mut links[agent], joins),
        allocator: |role: &mut AllocatorRole, joins| allocate(role, &mut allocator, joins),
    };
    toy::assert_same_log(&log.play(format()), &shared());
}

#[test]
fn processes_with_private_frames_decide_as_those_that_share_them() {
    let _watchdog = Watchdog::new();
    let alone = shared();
    let settings = WorldSettings { private: true, ..settings(EPISODES) };
    for bell in [BellKind::Doorbell, BellKind::Event] {
        let domain = toy::domain();
        let (mut log, settings) = (DecisionLog::default(), WorldSettings { bell, ..settings });
        let roles = ["private 0", "private 1", "allocator", "private 2"];
        run_processes(&domain, &roles, &settings, &mut log, &Stop::new()).unwrap();
        toy::assert_same_log(&log, &alone);
        assert_eq!(toy::leftovers(&domain), [""; 0]);
    }
}

/// Without an allocator nobody gets whole frames: the service has no publisher.
#[test]
fn whole_frames_are_for_an_allocator_only() {
    let _watchdog = Watchdog::new();
    let membership = toy::domain().enter().unwrap();
    let (bell, linger) = (BellKind::Event, Duration::ZERO);
    let setup =
        |name| LinkSetup { domain: membership.domain(), format: format(), name, bell, linger };
    let mut world = IoxWorld::<IntraProcess>::open_private(&setup("world"), false).unwrap();
    let mut whole = IoxAllocator::<IntraProcess>::open(&setup("allocator")).unwrap();
    let mut own = IoxAgent::<IntraProcess>::open_private(&setup("agent"), 1).unwrap();
    let mut role = world_role(format());
    role.shut_down(&mut world, &ToyWorld::new()).unwrap();
    assert!(!whole.receive_frames(&mut |_| true).unwrap());
    assert!(own.receive_frames(&mut |_| true).unwrap());
}

#[test]
fn a_runner_of_the_other_mode_is_refused() {
    let _watchdog = Watchdog::new();
    let refused = |private: bool, roles: &[&str]| {
        let (domain, settings) = (toy::domain(), WorldSettings { private, ..settings(1) });
        let ended = run_processes(&domain, roles, &settings, &mut (), &Stop::new());
        assert_eq!(toy::leftovers(&domain), [""; 0]);
        ended.unwrap_err().exit_code()
    };
    assert_eq!(refused(true, &["allocator", "private 0", "private 1", "private shared 2"]), 78);
    assert_eq!(refused(false, &["allocator", "0,2", "private 1"]), 78);
    assert_eq!(refused(true, &["allocator", "private 0", "private 1,2"]), 69);
}
