//! Teams whose agents act for subtasks (dissertation chapter 7): what acts under an allocation, who allocates, and both
//! as one team.
//!
//! A method that learns such agents tells of them by [`Method::subtasks`](crate::Method::subtasks). Whoever measures,
//! shows or deploys them pairs the agents with an allocator, the learned one or any other, in an [`AllocatedTeam`].

mod agents;
mod ahead;
mod allocators;
mod places;
mod symmetries;
mod team;

use sortie_envs::{Environment, Observation, Random, Spec};

use crate::act::Thought;
use crate::error::Result;
use crate::export::{AttentionNetwork, ExportError};

pub use agents::{MaskedViews, PolicyAgents, ScriptedAgents};
pub use ahead::LookingAhead;
pub use allocators::{
    DeployedAllocator, NoSubtasks, RuleAllocator, allocation_state, allocation_state_turned,
    allocation_state_within,
};
pub use places::{Place, Places};
pub use symmetries::{AllocateTurned, Course, best_course};
pub use team::AllocatedTeam;

/// Allocations that a policy draws, of which a critic takes the best (dissertation section 7.4).
pub const PROPOSALS: usize = 32;

/// The last action of an agent that has not acted yet in its episode.
pub const NO_ACTION: u8 = u8::MAX;

/// One state in which agents are to act for the subtasks that they have.
#[derive(Clone, Copy)]
pub struct AllocatedScene<'a> {
    /// Number of the world, the same as long as its episode runs: what agents remember belongs to it.
    pub world: usize,
    /// What observes the state.
    pub environment: &'a dyn Environment,
    /// The state.
    pub state: &'a [u8],
    /// All that there is to see in it.
    pub seen: &'a Observation,
    /// `[A]`: the subtask of every agent, or [`UNASSIGNED`](sortie_envs::UNASSIGNED).
    pub allocation: &'a [u8],
    /// `[A]`: the last action of every agent, or [`NO_ACTION`].
    pub last_actions: &'a [u8],
    /// What the agents were [advised](Agents::advise) at the last decision.
    pub strategies: &'a [f32],
}

/// Agents that act under whatever allocation they are given, the best that they know.
pub trait Agents {
    /// Writes `[scenes, A]` an available action of every agent that exists; a scene has `slots` agents A at most.
    ///
    /// # Errors
    /// The agents do not fit the environment.
    fn act(
        &mut self,
        scenes: &[AllocatedScene<'_>],
        actions: &mut [u16],
        slots: usize,
    ) -> Result<()>;

    /// Writes what a coach tells the agents of a state at a decision, for the scenes until the next one.
    ///
    /// Only agents with a coach are told anything.
    ///
    /// # Errors
    /// The coach does not fit the environment.
    fn advise(&mut self, _seen: &Observation, _strategies: &mut Vec<f32>) -> Result<()> {
        Ok(())
    }

    /// `[scenes, A]`: what the agents think, for whoever looks on; empty where they do not tell.
    fn thoughts(&mut self, _scenes: &[AllocatedScene<'_>]) -> Vec<Thought> {
        Vec::new()
    }
}

/// Agents that are to be allocated.
pub struct ToAllocate<'a> {
    /// What observes their state.
    pub environment: &'a dyn Environment,
    /// Their state.
    pub state: &'a [u8],
    /// The generator of their episode.
    pub random: &'a mut Random,
    /// `[A]`: comes with what was in force; the subtask of every agent is written here, or
    /// [`UNASSIGNED`](sortie_envs::UNASSIGNED).
    pub allocation: &'a mut [u8],
}

/// What assigns agents to subtasks at decision points.
pub trait Allocate {
    /// Writes an allocation.
    ///
    /// # Errors
    /// The allocator does not fit the environment.
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()>;

    /// What each of these teams, bit a of which stands for agent a, is worth at an open subtask; empty where it does not
    /// value them one by one.
    fn values(
        &mut self,
        _environment: &dyn Environment,
        _state: &[u8],
        _task: usize,
        _teams: &[u64],
    ) -> Vec<f32> {
        Vec::new()
    }

    /// Has it choose among so many proposals of its own in such an environment, or as many as it usually does; false where it
    /// does not propose.
    fn choose_among(&mut self, _proposals: Option<usize>, _spec: &Spec) -> bool {
        false
    }
}

impl<A: Allocate + ?Sized> Allocate for &mut A {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()> {
        (**self).allocate(to)
    }

    fn values(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        task: usize,
        teams: &[u64],
    ) -> Vec<f32> {
        (**self).values(environment, state, task, teams)
    }

    fn choose_among(&mut self, proposals: Option<usize>, spec: &Spec) -> bool {
        (**self).choose_among(proposals, spec)
    }
}

/// The agents of a method, and how they are allocated.
pub struct Subtasks<'a> {
    /// The agents, under whatever allocation.
    pub agents: Box<dyn Agents + 'a>,
    /// Whether they see subtasks; nobody allocates others.
    pub are_seen: bool,
    /// Steps between decisions, unless the open tasks change.
    pub interval: u32,
    /// What was learned to allocate with, if anything.
    pub allocator: Option<LearnedAllocator<'a>>,
}

impl<'a> Subtasks<'a> {
    /// The agents under an allocator.
    pub fn under(self, allocator: Box<dyn Allocate + 'a>) -> AllocatedTeam<'a> {
        AllocatedTeam::new(self.agents, allocator, self.interval)
    }
}

/// What a method has learned to allocate with, as it is deployed.
pub struct LearnedAllocator<'a> {
    /// The allocator, by the method's own pass.
    pub allocate: Box<dyn Allocate + 'a>,
    /// Its networks.
    pub networks: AllocatorNetworks<'a>,
    /// Largest team of one subtask that it forms, where that is limited.
    pub team_max: Option<usize>,
}

/// Writes the graphs of an allocator for the contract of this hash, in the order of their parts in a bundle.
pub type WriteGraphs<'a> = dyn Fn(u64) -> Result<[Vec<u8>; 3], ExportError> + 'a;

/// Writes encoder and decoder of an allocator that points, for so many agents and subtasks and the contract of this hash.
pub type WritePointing<'a> = dyn Fn([usize; 2], u64) -> Result<[Vec<u8>; 2], ExportError> + 'a;

/// What an allocator decides by.
pub enum AllocatorNetworks<'a> {
    /// It values single teams at single subtasks, and the best allocation is searched.
    TeamValue(Box<AttentionNetwork<'a>>),
    /// It proposes allocations, and a critic takes the best: trunk, step and critic.
    Proposals(Box<WriteGraphs<'a>>),
    /// It points at one subtask for each agent in turn: encoder and decoder.
    Pointing(Box<WritePointing<'a>>),
}
