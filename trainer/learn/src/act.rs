//! Teams that act: what they are shown, and what they tell of it.

use sortie_envs::{Environment, Random};

use crate::error::Result;

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
