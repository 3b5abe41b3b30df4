//! Teams that act: what they are shown, and what they tell of it.

use sortie_core::policy::Observation as Seen;
use sortie_core::{DecideError, Decision, EntityMask};
use sortie_envs::{ActionSet, EntitySet, Environment, Observation, Random, Shape, members};

use crate::error::{LearnError, Result};

/// A state in which a team is to act.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Number of the instance, the same as long as its episode runs: what agents remember belongs to it.
    pub instance: usize,
    /// The state, for [`Environment::observe`].
    pub state: &'a [u8],
    /// Whether it is the first of its episode.
    pub begins: bool,
    /// Whether the step before changed the set of unfinished subtasks, so that agents are to be allocated anew.
    pub tasks_changed: bool,
}

/// States of one environment in which teams are to act.
#[derive(Clone, Copy)]
pub struct Scenes<'a> {
    /// What observes them.
    pub environment: &'a dyn Environment,
    /// The states.
    pub scenes: &'a [Scene<'a>],
}

impl Scenes<'_> {
    /// The generators of the scenes, which are of different instances, out of those of all instances by their numbers.
    pub fn generators<'a>(&self, random: &'a mut [Random]) -> impl Iterator<Item = &'a mut Random> {
        let mut all: Vec<Option<&mut Random>> = random.iter_mut().map(Some).collect();
        self.scenes.iter().filter_map(move |scene| all.get_mut(scene.instance)?.take())
    }
}

/// What a team is asked to do.
pub struct Ask<'a> {
    /// In which it is to act.
    pub scenes: &'a Scenes<'a>,
    /// A generator for every instance, by its number.
    pub random: &'a mut [Random],
    /// `[scenes, A]`: what it does is written here, an available action of every agent that exists; what stands for others
    /// does not matter.
    pub actions: &'a mut [u16],
}

/// What an agent thinks in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Thought {
    /// `[U]`: scores of its actions, whose softmax are their chances.
    pub scores: Vec<f32>,
    /// Other agents and how much its critic looks at each, by heads; empty where it looks at nobody in particular.
    pub attention: Vec<(usize, Vec<f32>)>,
    /// What each of its heads thinks, where it explores by several.
    pub heads: Vec<Head>,
}

/// What one of the heads thinks by which an agent explores.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Head {
    /// What it explores for.
    pub name: String,
    /// Its intrinsic reward for being in this scene.
    pub pays: f32,
    /// The action that it likes best.
    pub likes: u16,
    /// Whether the agent acts by it.
    pub acts: bool,
}

/// What chooses the actions of all agents, the best that it knows.
pub trait Act {
    /// Writes the actions that it is asked for.
    ///
    /// # Errors
    /// The team cannot decide.
    fn act(&mut self, ask: Ask<'_>) -> Result<()>;

    /// `[A]`: the subtask that each agent of an instance acted for last, 255 for none; empty where there are none.
    fn allocation(&self, _instance: usize) -> &[u8] {
        &[]
    }

    /// `[scenes, A]`: what the agents think where these are their actions, for whoever looks on; empty where the team
    /// does not tell.
    fn thoughts(&mut self, _scenes: &Scenes<'_>, _actions: &[u16]) -> Vec<Thought> {
        Vec::new()
    }

    /// `[A, cells]`: how often each agent was in each cell of the map while it learned; empty where that is not counted.
    fn visits(&self) -> Vec<Vec<u32>> {
        Vec::new()
    }
}

/// What all agents of a team are shown of a state, as in frames: a row for every entity, and what each may do.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shown {
    features: usize,
    actions: usize,
    rows: Vec<f32>,
    /// `[A, U]`
    available: Vec<u16>,
}

impl Shown {
    /// Lays out what was observed of all entities.
    pub(crate) fn look(&mut self, seen: &Observation, shape: Shape) {
        (self.features, self.actions) = (shape.features, shape.actions);
        self.rows.clear();
        self.rows.resize(shape.entities * shape.features, 0.0);
        for entity in members(seen.present) {
            let row = &mut self.rows[entity * shape.features..][..shape.features];
            seen.rows.write_dense(seen.row_of(entity), row);
        }
        self.available.clear();
        self.available.extend(seen.available.iter().flat_map(|set| codes(*set, shape.actions)));
    }

    /// What one of the agents sees of it.
    pub(crate) fn to<'a>(
        &'a self,
        agent: usize,
        visible: EntityMask,
        last_actions: &'a [u16],
    ) -> Seen<'a> {
        Seen {
            rows: &self.rows,
            stride: self.features,
            last_actions,
            visible,
            self_index: agent,
            available: &self.available[agent * self.actions..][..self.actions],
        }
    }
}

/// A set of actions as policies are told of it: 1 for each of so many that it holds, else 0.
pub(crate) fn codes(set: ActionSet, actions: usize) -> impl Iterator<Item = u16> {
    (0..actions).map(move |action| (set >> action & 1) as u16)
}

/// A set of entities as policies are told of it.
pub(crate) fn mask(entities: EntitySet) -> EntityMask {
    EntityMask::from_words(&[entities as u64, (entities >> 64) as u64])
}

/// Writes the actions that were decided on.
pub(crate) fn write_actions(
    actions: &mut [u16],
    decisions: Vec<Result<Decision, DecideError>>,
) -> Result<()> {
    for (action, decision) in actions.iter_mut().zip(decisions) {
        *action = decision.map_err(|error| LearnError::Team(error.to_string()))?.action;
    }
    Ok(())
}
