//! A team and who allocates it, as one that plays anywhere.

use sortie_envs::{DecisionPoints, EntitySet, Observation, Random, UNASSIGNED};
use sortie_learn::{Act, LearnError, Scenes};

use super::{Allocate, Scene, Situation, Team};
use crate::alma::agents::NO_ACTION;

/// What an instance remembers between steps.
#[derive(Clone, Debug)]
struct Place {
    points: DecisionPoints,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    strategies: Vec<f32>,
    seen: Observation,
}

/// A team that is allocated at decision points.
pub struct AllocatedTeam<'a> {
    team: Box<dyn Team + 'a>,
    allocator: Box<dyn Allocate + 'a>,
    interval: u32,
    places: Vec<Place>,
}

impl<'a> AllocatedTeam<'a> {
    /// A team that is allocated every so many steps, and whenever the open tasks change.
    pub fn new(team: Box<dyn Team + 'a>, allocator: Box<dyn Allocate + 'a>, interval: u32) -> Self {
        Self { team, allocator, interval, places: Vec::new() }
    }

    /// Observes every scene, and decides where that is due.
    fn decide(&mut self, scenes: &Scenes<'_>, random: &mut [Random]) -> Result<(), LearnError> {
        let environment = scenes.environment;
        let agents = environment.spec().shape.agents;
        let new = || Place {
            points: DecisionPoints::every(self.interval),
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            seen: Observation::default(),
        };
        for scene in scenes.scenes {
            let places = self.places.len().max(scene.instance + 1);
            self.places.resize_with(places, new);
            let place = &mut self.places[scene.instance];
            if scene.begins {
                *place = new();
            }
            environment.observe(scene.state, 0, EntitySet::MAX, &mut place.seen);
            if place.points.is_due(scene.tasks_changed) {
                let Place { seen, last_actions, allocation, strategies, .. } = place;
                let situation = Situation { environment, state: scene.state, last_actions };
                let generator = &mut random[scene.instance];
                self.allocator.decide(situation, &mut *self.team, generator, allocation)?;
                self.team.advise(seen, strategies)?;
            }
        }
        Ok(())
    }
}

impl Act for AllocatedTeam<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.decide(scenes, random)?;
        let environment = scenes.environment;
        let agents = environment.spec().shape.agents;
        let Self { team, places, .. } = self;
        let shown = scenes.scenes.iter().map(|scene| {
            let Place { allocation, last_actions, strategies, seen, .. } = &places[scene.instance];
            let (world, state) = (scene.instance, scene.state);
            Scene { world, environment, state, seen, allocation, last_actions, strategies }
        });
        let shown: Vec<Scene<'_>> = shown.collect();
        team.act(&shown, actions, agents)?;
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact(agents)) {
            let last_actions = &mut places[scene.instance].last_actions;
            last_actions.iter_mut().zip(actions).for_each(|(last, action)| *last = *action as u8);
        }
        Ok(())
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        &self.places[instance].allocation
    }
}
