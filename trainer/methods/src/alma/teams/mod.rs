//! Who acts and who allocates, greedy: what can be measured, and what learners act by.
//!
//! Anything that chooses actions is a [`Team`]: the utility network in training ([`NetworkTeam`]), a deployed policy
//! ([`PolicyTeam`]) or the scripted low level ([`ScriptedActors`]).

mod allocated;
mod allocation;
mod allocators;
mod greedy;
mod players;

pub use allocated::AllocatedTeam;
pub use allocation::Allocation;
pub use allocators::{DeployedAllocator, NoSubtasks, RuleAllocator, allocation_state};
pub use greedy::{NetworkTeam, PolicyTeam, ScriptedActors};
pub use players::{Agents, Players};

use sortie_envs::{Environment, Observation};
use sortie_learn::LearnError;
use sortie_nn::random::Generator;

/// One state in which a team is to act.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// Number of the world, the same as long as its episode runs: what agents remember belongs to it.
    pub world: usize,
    /// What observes the state.
    pub environment: &'a dyn Environment,
    /// The state.
    pub state: &'a [u8],
    /// All that there is to see in it.
    pub seen: &'a Observation,
    /// The subtask of every agent, or [`sortie_envs::UNASSIGNED`].
    pub allocation: &'a [u8],
    /// The last action of every agent, or [`crate::alma::agents::NO_ACTION`].
    pub last_actions: &'a [u8],
    /// What the team was [advised](Team::advise) at the last decision.
    pub strategies: &'a [f32],
}

/// What chooses the actions of all agents.
pub trait Team {
    /// Writes one available action per existing agent of every scene into `actions` `[scenes, A]`.
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError>;

    /// Writes what a coach tells the agents of a state at a decision, for the scenes until the next one.
    ///
    /// Only teams with a coach write anything.
    fn advise(&mut self, seen: &Observation, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        let _ = (seen, strategies);
        Ok(())
    }
}

/// The moment of a decision, all that is needed to play on from it in a copy of the world.
#[derive(Clone, Copy)]
pub struct Situation<'a> {
    /// What observes the state.
    pub environment: &'a dyn Environment,
    /// The state.
    pub state: &'a [u8],
    /// The last action of every agent, or [`crate::alma::agents::NO_ACTION`].
    pub last_actions: &'a [u8],
}

/// What assigns agents to subtasks at decision points.
pub trait Allocate {
    /// Writes the subtask of every agent, or [`sortie_envs::UNASSIGNED`]; `allocation` comes with what was in force.
    /// `generator` belongs to the episode.
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError>;

    /// The same, with what a copy of the world could be played on from. Only [a planner](crate::alma::evaluate::Planner) looks at it.
    fn decide(
        &mut self,
        situation: Situation<'_>,
        team: &mut dyn Team,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let _ = team;
        self.allocate(situation.environment, situation.state, generator, allocation)
    }
}

impl<T: Team + ?Sized> Team for &mut T {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        (**self).act(scenes, actions, agents)
    }

    fn advise(&mut self, seen: &Observation, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        (**self).advise(seen, strategies)
    }
}

impl<A: Allocate + ?Sized> Allocate for &mut A {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        (**self).allocate(environment, state, generator, allocation)
    }

    fn decide(
        &mut self,
        situation: Situation<'_>,
        team: &mut dyn Team,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        (**self).decide(situation, team, generator, allocation)
    }
}
