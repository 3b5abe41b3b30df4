//! What pages show of an environment: of an episode that was played before, and of one that is played as they are looked at.

use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Serialize;
use sortie_core::World;
use sortie_envs::{Entry, Environment, Episode};

use crate::error::StageError;
use crate::stage::Stage;

/// An instance of an environment, and its state as bytes.
#[derive(Clone, Copy)]
pub struct Glance<'a> {
    /// All instances.
    pub worlds: &'a dyn Environment,
    /// The one that is looked at.
    pub instance: usize,
    /// As it saves it.
    pub state: &'a [u8],
}

impl<'a> Glance<'a> {
    /// At an instance, whose state goes to `state`.
    pub fn at(worlds: &'a dyn Environment, instance: usize, state: &'a mut Vec<u8>) -> Self {
        state.clear();
        worlds.save(instance, state);
        Self { worlds, instance, state }
    }
}

/// A state as it is shown, and the step that led to it.
#[derive(Clone, Debug)]
pub struct Shown<S: Show> {
    /// None where the episode begins.
    pub step: Option<S::Step>,
    /// The state.
    pub state: S::State,
}

/// What pages show of an environment, in the types that their scripts read as JSON.
pub trait Show: Sized + 'static {
    /// What does not change while an episode is played.
    type Facts: Serialize;
    /// What there is to see of a state, without what anybody thinks in it.
    type State: Clone + Serialize;
    /// What happened between two states.
    type Step: Clone + Serialize;
    /// Something worth jumping to.
    type Event: Serialize;

    /// How the environment is found.
    fn entry() -> &'static Entry;

    /// What does not change, at the first state of an episode.
    fn facts(first: Glance<'_>) -> Self::Facts;

    /// Agents that there are.
    fn agents(facts: &Self::Facts) -> usize;

    /// A state.
    fn state(seen: Glance<'_>) -> Self::State;

    /// The step from one state to the next, for what the agents did.
    fn step(
        seen: Glance<'_>,
        actions: &[u16],
        reward: f64,
        states: [&Self::State; 2],
    ) -> Self::Step;

    /// What shows in a state, the first of which has none before it.
    fn events(
        facts: &Self::Facts,
        at: usize,
        before: Option<&Shown<Self>>,
        now: &Shown<Self>,
    ) -> Vec<Self::Event>;

    /// How an episode has ended.
    fn result(episode: &Episode) -> &'static str {
        if episode.solved { "solved" } else { "timed-out" }
    }

    /// Adds to a state who is assigned where, in environments whose agents are.
    ///
    /// # Errors
    /// What teams are worth cannot be computed.
    fn assign<W: World>(
        state: &mut Self::State,
        stage: &mut Stage<'_, W>,
    ) -> Result<(), StageError> {
        let _ = (state, stage);
        Ok(())
    }

    /// Does to a thing, by its number, what may come about by chance as well.
    ///
    /// # Errors
    /// Why nothing comes of it.
    fn disturb(worlds: &mut dyn Environment, instance: usize, thing: usize) -> Result<(), String> {
        let _ = (worlds, instance, thing);
        Err("nothing can happen to it".to_string())
    }
}
