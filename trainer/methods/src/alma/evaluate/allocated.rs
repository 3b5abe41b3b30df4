//! A team and who allocates it, as one that plays anywhere.

use sortie_envs::Random;
use sortie_envs::save_the_city::{DecisionPoints, UNASSIGNED};
use sortie_learn::{Act, LearnError, Scenes};

use super::{Allocate, Scene, Situation, Team};
use crate::alma::cities::CityState;
use crate::alma::records::NO_ACTION;

/// What an instance remembers between steps.
#[derive(Clone, Debug)]
struct Place {
    points: DecisionPoints,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    strategies: Vec<f32>,
    city: CityState,
    steps: u32,
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

    /// Takes over the state of every scene, and decides where that is due.
    fn decide(&mut self, scenes: &Scenes<'_>, random: &mut [Random]) -> Result<(), LearnError> {
        let agents = scenes.environment.spec().shape.agents;
        let new = || Place {
            points: DecisionPoints::every(self.interval),
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            city: CityState::default(),
            steps: 0,
        };
        for scene in scenes.scenes {
            let places = self.places.len().max(scene.instance + 1);
            self.places.resize_with(places, new);
            let place = &mut self.places[scene.instance];
            if scene.begins {
                *place = new();
            }
            place.city.read(scene.state);
            if place.points.is_due(scene.tasks_changed) {
                let Place { city, last_actions, allocation, strategies, steps, .. } = place;
                let city = city.city();
                let situation = Situation { city, last_actions, steps: *steps };
                let generator = &mut random[scene.instance];
                self.allocator.decide(situation, &mut *self.team, generator, allocation)?;
                self.team.advise(city, strategies)?;
            }
            place.steps += 1;
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
        let agents = scenes.environment.spec().shape.agents;
        let Self { team, places, .. } = self;
        let scene = |scene: &sortie_learn::Scene<'_>| {
            let Place { allocation, last_actions, strategies, city, .. } = &places[scene.instance];
            Scene { world: scene.instance, city: city.city(), allocation, last_actions, strategies }
        };
        let shown: Vec<Scene<'_>> = scenes.scenes.iter().map(scene).collect();
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
