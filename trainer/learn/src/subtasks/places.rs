//! What instances remember between steps in which agents act for subtasks, be it where teams are measured or where they
//! learn.

use serde::{Deserialize, Serialize};
use sortie_envs::{DecisionPoints, EntitySet, Environment, Observation, UNASSIGNED};

use super::{AllocatedScene, NO_ACTION};
use crate::act::{Scene, Scenes};
use crate::error::{LearnError, Result};
use crate::state::State;

/// What an instance remembers between steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    points: DecisionPoints,
    /// Whether agents are to be allocated anew in the state that is seen.
    pub is_due: bool,
    /// `[A]`: the subtask of every agent.
    pub allocation: Vec<u8>,
    /// `[A]`: what the agents had done when they came into the state that is seen.
    pub last_actions: Vec<u8>,
    /// `[A]`: what they do in it.
    actions: Vec<u8>,
    /// What they were advised at the last decision.
    pub strategies: Vec<f32>,
    /// What there is to see in the state in which they act.
    #[serde(skip)]
    pub seen: Observation,
}

/// What all instances remember, by their numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Places {
    interval: u32,
    places: Vec<Place>,
}

impl Places {
    /// No instance yet; agents are to be allocated every so many steps, and whenever the open tasks change.
    pub fn new(interval: u32) -> Self {
        Self { interval, places: Vec::new() }
    }

    /// Observes a scene, and finds out whether agents are to be allocated anew in it.
    pub fn look(&mut self, environment: &dyn Environment, scene: &Scene<'_>) -> &mut Place {
        let Self { interval, places } = self;
        let agents = environment.spec().shape.agents;
        let new = || Place {
            points: DecisionPoints::every(*interval),
            is_due: false,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            seen: Observation::default(),
        };
        places.resize_with(places.len().max(scene.instance + 1), new);
        let place = &mut places[scene.instance];
        if scene.begins {
            *place = new();
        }
        place.last_actions.copy_from_slice(&place.actions);
        environment.observe(scene.state, 0, EntitySet::MAX, &mut place.seen);
        place.is_due = place.points.is_due(scene.tasks_changed);
        place
    }

    /// What an instance remembers.
    pub fn of(&self, instance: usize) -> &Place {
        &self.places[instance]
    }

    /// The same, to be changed.
    pub(crate) fn of_mut(&mut self, instance: usize) -> &mut Place {
        &mut self.places[instance]
    }

    /// Scenes that were [looked](Self::look) at as agents see them.
    pub fn scenes<'a>(&'a self, scenes: &Scenes<'a>) -> Vec<AllocatedScene<'a>> {
        let environment = scenes.environment;
        let shown = scenes.scenes.iter().map(|scene| {
            let Place { allocation, last_actions, strategies, seen, .. } = self.of(scene.instance);
            let (world, state) = (scene.instance, scene.state);
            AllocatedScene { world, environment, state, seen, allocation, last_actions, strategies }
        });
        shown.collect()
    }

    /// Writes down the actions `[scenes, A]` that agents take in scenes.
    pub fn note(&mut self, scenes: &Scenes<'_>, actions: &[u16]) {
        let slots = scenes.environment.spec().shape.agents;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact(slots)) {
            self.did(scene.instance, actions);
        }
    }

    /// The same of one instance. Environments have few actions.
    pub(crate) fn did(&mut self, instance: usize, taken: &[u16]) {
        let noted = self.places[instance].actions.iter_mut();
        noted.zip(taken).for_each(|(noted, taken)| *noted = *taken as u8);
    }

    /// Has a second instance go on from where a first one stands.
    pub(crate) fn copy(&mut self, from: usize, to: usize) -> &mut Place {
        let place = self.places[from].clone();
        self.places.resize(self.places.len().max(to + 1), place.clone());
        self.places[to] = place;
        &mut self.places[to]
    }

    /// Names all of it.
    ///
    /// # Errors
    /// What is read is of teams of another size.
    pub fn visit(&mut self, state: &mut State<'_>, agents: usize) -> Result<()> {
        state.value("places", &mut self.places)?;
        let fits = |place: &Place| [place.allocation.len(), place.actions.len()] == [agents; 2];
        if self.places.iter().all(fits) {
            return Ok(());
        }
        Err(LearnError::Config("the checkpoint has other instances".to_owned()))
    }
}
