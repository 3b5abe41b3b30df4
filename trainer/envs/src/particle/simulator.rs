//! Many episodes of one scenario at once: resets, steps and states.

use alloc::vec;
use alloc::vec::Vec;

use super::physics::ACTIONS;
use super::plane::Point;
use super::scenario::Scenario;
use super::spec::spec;
use super::states::{self, State};
use super::treasure::{Hoard, TreasureCollection};
use crate::environment::{StateError, Step, StepError};
use crate::random::Random;
use crate::spec::Spec;

/// How far from the middle anything can be put, in half sides of the square that everything starts in.
const FARTHEST: f64 = 2.0;

/// A scenario of the plane, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Particle<S: Scenario> {
    scenario: S,
    spec: Spec,
    episodes: Vec<Episode<S::World>>,
}

/// What an instance has once.
#[derive(Clone, Debug)]
pub(super) struct Episode<W> {
    pub(super) world: W,
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) rewards: Vec<f64>,
}

impl<S: Scenario> Particle<S> {
    /// Sets up so many instances, whose episodes are over.
    pub fn new(scenario: S, instances: usize) -> Self {
        let spec = spec(&scenario);
        let episode = Episode {
            world: scenario.world(),
            steps: spec.episode_limit,
            episode_return: 0.0,
            rewards: vec![0.0; spec.shape.agents],
        };
        Self { episodes: vec![episode; instances], scenario, spec }
    }

    /// The rules.
    pub fn scenario(&self) -> &S {
        &self.scenario
    }

    pub(super) fn own_spec(&self) -> &Spec {
        &self.spec
    }

    pub(super) fn count(&self) -> usize {
        self.episodes.len()
    }

    pub(super) fn running(&self, instance: usize) -> &Episode<S::World> {
        &self.episodes[instance]
    }

    /// Where everything is.
    pub fn world(&self, instance: usize) -> &S::World {
        &self.running(instance).world
    }

    /// Whether the episode is over and the instance waits for a reset.
    pub fn is_done(&self, instance: usize) -> bool {
        self.running(instance).steps >= self.spec.episode_limit
    }

    /// Starts an episode from a world that the scenario can be in.
    pub fn start(&mut self, instance: usize, world: S::World) {
        let episode = &mut self.episodes[instance];
        (episode.world, episode.steps, episode.episode_return) = (world, 0, 0.0);
    }

    /// Starts an episode from a world that is drawn.
    pub(super) fn draw(&mut self, instance: usize, random: &mut Random) {
        let episode = &mut self.episodes[instance];
        self.scenario.reset(&mut episode.world, random);
        (episode.steps, episode.episode_return) = (0, 0.0);
    }

    /// Plays one step with actions that are checked before.
    #[inline]
    pub(super) fn step_with(
        &mut self,
        instance: usize,
        actions: &[u16],
        play: impl FnOnce(&S, &mut S::World, &[u16], &mut [f64]),
    ) -> Result<Step, StepError> {
        if self.is_done(instance) {
            return Err(StepError::EpisodeOver);
        }
        let (agents, given) = (self.spec.shape.agents, actions.len());
        let actions =
            actions.get(..agents).ok_or(StepError::TooFewActions { agents, actions: given })?;
        let unknown = actions.iter().position(|action| usize::from(*action) >= ACTIONS);
        if let Some(agent) = unknown {
            return Err(StepError::Unavailable { agent, action: actions[agent] });
        }
        let Episode { world, steps, episode_return, rewards } = &mut self.episodes[instance];
        play(&self.scenario, world, actions, rewards);
        *steps += 1;
        let reward = rewards.iter().sum::<f64>() / agents as f64;
        *episode_return += reward;
        let timed_out = *steps >= self.spec.episode_limit;
        Ok(Step { reward, timed_out, ..Step::default() })
    }

    /// Puts an agent or a thing elsewhere, where it comes to rest.
    pub(super) fn put(
        &mut self,
        instance: usize,
        entity: usize,
        place: Point,
    ) -> Result<(), StateError> {
        let refused = |reason: &str| Err(StateError::Impossible(reason.into()));
        if !place.iter().all(|part| part.abs() <= FARTHEST) {
            return refused("that is too far away");
        }
        let world = &mut self.episodes[instance].world;
        let Some((position, velocity)) = self.scenario.entity(world, entity) else {
            return refused("it is nowhere, and stays there");
        };
        *position = place;
        if let Some(velocity) = velocity {
            *velocity = [0.0; 2];
        }
        Ok(())
    }

    pub(super) fn write_state(&self, instance: usize, state: &mut Vec<u8>) {
        let Episode { world, steps, episode_return, .. } = &self.episodes[instance];
        states::write(&self.scenario, (*steps, *episode_return, world), state);
    }

    pub(super) fn read_state(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let State { steps, episode_return, world } = self.state(state)?;
        let episode = &mut self.episodes[instance];
        (episode.world, episode.steps, episode.episode_return) = (world, steps, episode_return);
        Ok(())
    }

    /// What the bytes of a state say.
    pub(super) fn state(&self, state: &[u8]) -> Result<State<S::World>, StateError> {
        states::read(&self.scenario, self.spec.state_bytes, state)
    }
}

impl Particle<TreasureCollection> {
    /// Steps where `draw` says place and kind of each treasure, by its number, that follows a taken one: for replays.
    ///
    /// # Errors
    /// As [`Environment::step`](crate::Environment::step).
    pub fn step_drawn(
        &mut self,
        instance: usize,
        actions: &[u16],
        draw: impl FnMut(usize) -> ([f64; 2], u8),
    ) -> Result<Step, StepError> {
        self.step_with(instance, actions, |scenario, world: &mut Hoard, actions, rewards| {
            scenario.step_by(world, actions, rewards, draw);
        })
    }
}
