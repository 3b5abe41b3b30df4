//! A process: a role, its link, and what a loop around them would remember.

use sortie_core::link::{AgentLink, AllocLink, LinkError};
use sortie_core::roles::{
    AllocatorError, AllocatorOptions, AllocatorRole, Identity, Poll, RunnerOptions, RunnerRole,
    TickReport, WorldError, WorldObserver, WorldOptions, WorldRole,
};

use super::hosts::{FarProcess, StandIn};
use super::link::SimulatedLink;
use super::network::Shared;
use super::planted::{Memory, PlantedLink};
use super::setup::{MILLISECOND, Setup};
use super::toy::{self, ToyAllocator, ToyPolicy, ToyWorld};

/// How a process is woken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wake {
    /// It had more to do, or was just started.
    Busy,
    Rung,
    Timeout,
    /// It had been stopped.
    Continued,
}

/// What a process is.
pub(crate) enum Body {
    World { role: Box<WorldRole>, world: ToyWorld },
    Runner(Box<RunnerRole>),
    Allocator(Box<AllocatorRole>),
    StandIn(Box<StandIn>),
    Away(Box<FarProcess>),
}

pub(crate) struct Process {
    pub(crate) pid: u32,
    pub(crate) body: Body,
    link: SimulatedLink,
    memory: Memory,
    costs: Vec<f32>,
    /// Wake-ups planned for an earlier state of the process do not count.
    pub(crate) plan: u64,
    pub(crate) is_asleep: bool,
    pub(crate) stopped_until_ns: u64,
}

/// What came of a poll.
pub(crate) enum Polled {
    Next(Poll),
    /// It was killed in the middle of it.
    Killed,
    Failed(String),
}

impl Process {
    pub(crate) fn new(pid: u32, body: Body, link: SimulatedLink, setup: &Setup) -> Self {
        Self {
            pid,
            body,
            link,
            memory: Memory::default(),
            costs: vec![0.0; setup.agents * toy::TASKS],
            plan: 0,
            is_asleep: false,
            stopped_until_ns: 0,
        }
    }

    /// Says hello; the world says nothing.
    pub(crate) fn join(&mut self) -> Result<(), LinkError> {
        match &mut self.body {
            Body::World { .. } | Body::StandIn(_) | Body::Away(_) => Ok(()),
            Body::Runner(role) => role.join(&mut self.link),
            Body::Allocator(role) => role.join(&mut self.link),
        }
    }

    /// Says goodbye.
    pub(crate) fn leave(&mut self) -> Result<(), LinkError> {
        match &mut self.body {
            Body::World { role, world } => match role.shut_down(&mut self.link, world) {
                Err(WorldError::Link(error)) => Err(error),
                _ => Ok(()),
            },
            Body::Runner(role) => role.leave(&mut self.link),
            Body::Allocator(role) => role.leave(&mut self.link),
            Body::StandIn(_) => Ok(()),
            Body::Away(away) => away.leave(),
        }
    }

    /// Polls its role, through a link with the planted bug if there is one.
    pub(crate) fn poll(&mut self, setup: &Setup, network: &Shared) -> Polled {
        let Self { body, link, memory, costs, .. } = self;
        let polled = match body {
            Body::World { role, world } => match role.poll(link, world, &mut Watch(network)) {
                Err(WorldError::Link(_)) => Err(None),
                polled => polled.map_err(|error| Some(error.to_string())),
            },
            Body::Runner(role) => match setup.planted {
                None => poll_runner(role, link, costs, setup),
                Some(bug) => {
                    poll_runner(role, &mut PlantedLink { link, memory, bug }, costs, setup)
                }
            },
            Body::Allocator(role) => match setup.planted {
                None => poll_allocator(role, link, costs, setup),
                Some(bug) => {
                    poll_allocator(role, &mut PlantedLink { link, memory, bug }, costs, setup)
                }
            },
            Body::StandIn(stand_in) => match setup.planted {
                None => stand_in.poll(link).map_err(|_| None),
                Some(bug) => {
                    stand_in.poll(&mut PlantedLink { link, memory, bug }).map_err(|_| None)
                }
            },
            Body::Away(away) => {
                let now_ns = network.borrow().now_ns;
                away.poll(now_ns).map_err(|_| None)
            }
        };
        match polled {
            Ok(poll) => Polled::Next(poll),
            Err(None) => Polled::Killed,
            Err(Some(error)) => Polled::Failed(error),
        }
    }
}

fn poll_runner(
    role: &mut RunnerRole,
    link: &mut impl AgentLink,
    costs: &mut [f32],
    setup: &Setup,
) -> Result<Poll, Option<String>> {
    let polled = if setup.heuristic {
        role.poll_with_heuristic(link, &mut ToyPolicy, &mut toy::heuristic(costs))
    } else {
        role.poll(link, &mut ToyPolicy)
    };
    polled.map_err(|_| None)
}

fn poll_allocator(
    role: &mut AllocatorRole,
    link: &mut impl AllocLink,
    costs: &mut [f32],
    setup: &Setup,
) -> Result<Poll, Option<String>> {
    let polled = if setup.heuristic {
        let mut allocator = ToyAllocator { refuses: true };
        role.poll_with_heuristic(link, &mut allocator, &mut toy::heuristic(costs))
    } else {
        role.poll(link, &mut ToyAllocator { refuses: false })
    };
    polled.map_err(|error| match error {
        AllocatorError::Link(_) => None,
        other => Some(other.to_string()),
    })
}

/// Tells the oracle what the world does.
struct Watch<'a>(&'a Shared);

impl WorldObserver for Watch<'_> {
    fn tick(&mut self, report: &TickReport<'_>) {
        let mut network = self.0.borrow_mut();
        let now = network.now_ns;
        network.allocations_missed = report.allocations_missed;
        network.oracle.ticked(now, report);
    }
}

pub(crate) fn world(setup: &Setup, term: u32) -> Body {
    let role = Box::new(WorldRole::new(world_options(setup, term)));
    Body::World { role, world: ToyWorld::new(setup.agents, setup.seed ^ u64::from(term) << 48) }
}

pub(crate) fn world_options(setup: &Setup, term: u32) -> WorldOptions {
    WorldOptions {
        format: setup.format,
        identity: Identity::new(1, "world"),
        term,
        required: (1 << setup.agents) - 1,
        allocator: true,
        strict: false,
        pipelined: setup.pipelined,
        join_patience_ns: 20 * MILLISECOND,
        period_ns: setup.period_ns,
        patience_ns: setup.patience_ns,
        absent_after: 3,
        absent: 0,
        decision_interval: setup.decision_interval,
        safe_action: Some(toy::SAFE),
        episodes: None,
        tick_interval_ns: setup.tick_interval_ns,
    }
}

pub(crate) fn runner(setup: &Setup, pid: u32, agents: u64) -> RunnerRole {
    RunnerRole::new(RunnerOptions {
        format: setup.format,
        identity: Identity::new(pid, "runner"),
        agents,
        subtasks: true,
        decision_interval: setup.decision_interval,
        period_ns: setup.period_ns,
        safe_action: Some(toy::SAFE),
    })
}

pub(crate) fn allocator(setup: &Setup, pid: u32) -> AllocatorRole {
    AllocatorRole::new(AllocatorOptions {
        format: setup.format,
        identity: Identity::new(pid, "allocator"),
        decision_interval: setup.decision_interval,
    })
}
