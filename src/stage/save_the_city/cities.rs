//! The episodes of a seed, one after the other, as evaluations number them.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use core::any::Any;

use sortie_core::wire::FrameMut;
use sortie_core::world::{Shape, StepOutcome, UnavailableAction, World};
use sortie_envs::random::episode;
use sortie_envs::save_the_city::{CityError, ENTRY, SaveTheCity};
use sortie_envs::{Choice, Environment, EnvironmentError, Split, UNASSIGNED};

use super::data::{EpisodeResult, State, Step};
use super::facts::{result, state, step};
use crate::world::EnvironmentWorld;

/// Cities, each the start of the next episode of a seed.
pub(super) struct Cities {
    world: EnvironmentWorld,
    seed: u64,
    next: usize,
    stepped: Option<Stepped>,
}

/// A step, and the state that it led to.
pub(super) struct Stepped {
    pub(super) step: Step,
    pub(super) state: State,
    /// Where the episode is over.
    pub(super) result: Option<EpisodeResult>,
}

impl Cities {
    /// The starts of a set that are measured on, from episode `first` of `seed` on.
    pub(super) fn new(set: &str, seed: u64, first: usize) -> Result<Self, EnvironmentError> {
        let choice =
            Choice { set: Some(set), split: Split::Test, instances: 1, settings: &BTreeMap::new() };
        let environment: Box<dyn Environment> = (ENTRY.open)(&choice)?;
        let world = EnvironmentWorld::not_begun(environment, episode(seed, first).0);
        Ok(Self { world, seed, next: first, stepped: None })
    }

    /// The step since the last call, if there was one.
    pub(super) fn take_step(&mut self) -> Option<Stepped> {
        self.stepped.take()
    }

    /// Calls `with` on the city of the running episode.
    pub(super) fn with<T>(&self, with: impl FnOnce(&SaveTheCity) -> T) -> T {
        let environment = self.world.environment.borrow();
        let environment: &dyn Any = &**environment;
        with(environment.downcast_ref().expect("made by this environment's entry"))
    }

    /// Changes the city of the running episode.
    pub(super) fn change(
        &self,
        change: impl FnOnce(&mut SaveTheCity) -> Result<(), CityError>,
    ) -> Result<(), CityError> {
        let mut environment = self.world.environment.borrow_mut();
        let environment: &mut dyn Any = &mut **environment;
        change(environment.downcast_mut().expect("made by this environment's entry"))
    }
}

impl World for Cities {
    fn shape(&self) -> Shape {
        self.world.shape()
    }

    fn reset(&mut self) {
        self.world.draw_from(episode(self.seed, self.next).0);
        self.next += 1;
        self.world.reset();
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        self.world.observe(frame);
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        let outcome = self.world.step(actions)?;
        let reward = self.world.last_step().reward;
        let nobody = [UNASSIGNED; sortie_envs::Shape::AGENTS];
        self.stepped = Some(self.with(|cities| Stepped {
            step: step(cities, 0, actions, reward),
            state: state(cities.city(0), &nobody),
            result: outcome.episode_ended.then(|| result(cities.metrics(0))),
        }));
        Ok(outcome)
    }
}
