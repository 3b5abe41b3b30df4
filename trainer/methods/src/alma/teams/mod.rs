//! Who acts and who allocates, greedy: what can be measured, and what learners act by.
//!
//! Anything that chooses actions is a [`Team`]: the utility network in training ([`NetworkTeam`]), a deployed policy
//! ([`PolicyTeam`]) or the scripted low level ([`ScriptedActors`]).

mod allocated;
mod greedy;

use serde::{Deserialize, Serialize};
use sortie_bundle::OwnedAllocationState;
use sortie_core::{Allocator, EntityMask};
use sortie_envs::{EntitySet, Environment, Observation, UNASSIGNED, members};
use sortie_learn::LearnError;
use sortie_nn::random::Generator;

pub use allocated::AllocatedTeam;
pub use greedy::{Agents, NetworkTeam, Players, PolicyTeam, ScriptedActors};

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

/// Who allocates in an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Allocation {
    /// The allocator of the run.
    Learned,
    /// The environment's rule that looks at the whole team.
    Coordinated,
    /// The reference's heuristic.
    Heuristic,
    /// Chance.
    Random,
}

impl Allocation {
    const ALL: [Self; 4] = [Self::Learned, Self::Coordinated, Self::Heuristic, Self::Random];

    /// The allocator of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|allocation| allocation.name() == name)
    }

    /// Its name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Coordinated => "coordinated",
            Self::Heuristic => "heuristic",
            Self::Random => "random",
        }
    }

    /// The environment's rule of this name.
    pub fn allocator(self) -> RuleAllocator {
        RuleAllocator(self.name())
    }
}

/// One of the [rules](sortie_envs::Spec::rules) of an environment, by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RuleAllocator(pub &'static str);

impl Allocate for RuleAllocator {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let spec = environment.spec();
        let known = spec.rules.iter().position(|rule| rule.name == self.0);
        let unknown = || {
            let names: Vec<&str> = spec.rules.iter().map(|rule| rule.name).collect();
            let (name, names) = (spec.name, names.join("`, `"));
            LearnError::Team(format!(
                "`{name}` has no rule `{}` of allocation; it has `{names}`",
                self.0
            ))
        };
        environment.allocate(known.ok_or_else(unknown)?, state, generator, allocation);
        Ok(())
    }
}

/// Assigns nobody: what agents need that know of no subtasks.
#[derive(Clone, Copy, Debug)]
pub struct NoSubtasks;

impl Allocate for NoSubtasks {
    fn allocate(
        &mut self,
        _: &dyn Environment,
        _: &[u8],
        _: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        allocation.fill(UNASSIGNED);
        Ok(())
    }
}

/// A deployed allocator, on what it would see of a state.
pub struct DeployedAllocator<'a>(pub Box<dyn Allocator + 'a>);

impl Allocate for DeployedAllocator<'_> {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        _: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let mut state = allocation_state(environment, state);
        // What a policy proposes depends on what was in force.
        for (tasks, last) in state.entity_task.iter_mut().zip(&allocation[..state.agents]) {
            *tasks = 1_u32.checked_shl((*last).into()).unwrap_or(0);
        }
        allocation.fill(UNASSIGNED);
        let team = &mut allocation[..state.agents];
        self.0.allocate(&state.view(), team).map_err(|error| LearnError::Team(error.to_string()))
    }
}

/// All that an allocator sees of a state; agents come without their last allocation.
pub fn allocation_state(environment: &dyn Environment, state: &[u8]) -> OwnedAllocationState {
    let features = environment.spec().shape.features;
    let mut seen = Observation::default();
    environment.observe(state, 0, EntitySet::MAX, &mut seen);
    let mut rows = Vec::new();
    seen.rows.write_all(features, &mut rows);
    let mut present = EntityMask::first(seen.rows.len());
    members(seen.absent.into()).for_each(|agent| present.remove(agent));
    OwnedAllocationState {
        agents: seen.agents(),
        tasks: seen.tasks(),
        rows,
        features,
        present,
        entity_task: members(seen.present).map(|entity| seen.entity_task[entity]).collect(),
        open_tasks: seen.open_tasks,
    }
}
