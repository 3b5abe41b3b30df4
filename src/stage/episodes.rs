//! The episodes of a seed, one after the other, as evaluations number them.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;
use core::cell::RefCell;

use sortie_core::wire::FrameMut;
use sortie_core::world::{Shape, StepOutcome, UnavailableAction, World};
use sortie_envs::random::episode;
use sortie_envs::{Choice, Environment, EnvironmentError, Split};

use crate::show::{Glance, Show, Shown};
use crate::world::EnvironmentWorld;

/// Worlds, each the start of the next episode of a seed.
pub(crate) struct Episodes<S: Show> {
    world: EnvironmentWorld,
    seed: u64,
    next: usize,
    stepped: Option<Stepped<S>>,
    /// Room for a state.
    state: RefCell<Vec<u8>>,
}

/// A step with the state that it led to.
pub(crate) struct Stepped<S: Show> {
    pub(crate) shown: Shown<S>,
    /// Where the episode is over.
    pub(crate) result: Option<&'static str>,
}

impl<S: Show> Episodes<S> {
    /// The starts of a set that are measured on, from episode `first` of `seed` on.
    pub(crate) fn new(set: &str, seed: u64, first: usize) -> Result<Self, EnvironmentError> {
        let choice =
            Choice { set: Some(set), split: Split::Test, instances: 1, settings: &BTreeMap::new() };
        let environment = (S::entry().open)(&choice)?;
        let world = EnvironmentWorld::not_begun(environment, episode(seed, first).0);
        Ok(Self { world, seed, next: first, stepped: None, state: RefCell::default() })
    }

    /// The step since the last call, if there was one.
    pub(crate) fn take_step(&mut self) -> Option<Stepped<S>> {
        self.stepped.take()
    }

    /// Calls `with` on the running episode.
    pub(crate) fn with<T>(&self, with: impl FnOnce(Glance<'_>) -> T) -> T {
        let (environment, mut state) = (self.world.environment.borrow(), self.state.borrow_mut());
        with(Glance::at(&**environment, 0, &mut state))
    }

    /// Changes the running episode.
    pub(crate) fn change<E>(
        &self,
        change: impl FnOnce(&mut dyn Environment) -> Result<(), E>,
    ) -> Result<(), E> {
        change(&mut **self.world.environment.borrow_mut())
    }
}

impl<S: Show> World for Episodes<S> {
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
        let before = self.with(S::state);
        let outcome = self.world.step(actions)?;
        let reward = self.world.last_step().reward;
        self.stepped = Some(self.with(|seen| {
            let state = S::state(seen);
            let step = Some(S::step(seen, actions, reward, [&before, &state]));
            let ended = outcome.episode_ended.then(|| seen.worlds.episode(seen.instance));
            let result = ended.map(|episode| S::result(&episode));
            Stepped { shown: Shown { step, state }, result }
        }));
        Ok(outcome)
    }
}
