//! What has been seen, as single steps or as whole episodes.

use sortie_envs::{Environment, Random, Spec};
use sortie_learn::run::UpdateReport;
use sortie_learn::state::State;
use sortie_learn::{LearnError, Transition};

use super::config::{ReplayConfig, Unit};
use super::episodes::Episodes;
use super::learner::{Learner, Update};
use super::replay::{End, Replay};

/// Steps or episodes.
#[derive(Debug)]
pub(super) enum Experience {
    Steps(Replay),
    Episodes(Episodes),
}

impl Experience {
    /// Room for as much as is to be kept of so many instances.
    pub(super) fn new(config: &ReplayConfig, instances: usize, spec: &Spec) -> Self {
        let (agents, bytes) = (spec.shape.agents, spec.state_bytes);
        let capacity = config.capacity;
        match config.unit {
            Unit::Steps => Self::Steps(Replay::new(instances, capacity / instances, agents, bytes)),
            Unit::Episodes => Self::Episodes(Episodes::new(instances, capacity, agents)),
        }
    }

    /// Adds a step.
    pub(super) fn push(&mut self, transition: &Transition<'_>) {
        let Transition { instance, state, actions, step, next, .. } = *transition;
        let end = match (step.terminated, step.timed_out) {
            (true, _) => End::Over,
            (_, true) => End::TimedOut,
            _ => End::Open,
        };
        let reward = step.reward as f32;
        match self {
            Self::Steps(replay) => {
                replay.push(instance, state, actions, reward, end);
                if step.done() {
                    replay.push_last(instance, next);
                }
            }
            Self::Episodes(episodes) => {
                episodes.push(instance, (state, actions), (reward, end), next);
            }
        }
    }

    /// Episodes that have ended, where they are counted.
    pub(super) fn finished(&self) -> u64 {
        match self {
            Self::Steps(_) => 0,
            Self::Episodes(episodes) => episodes.finished(),
        }
    }

    /// An update from what has been seen; `None` while that is less than a batch.
    pub(super) fn teach(
        &self,
        learner: &mut Learner,
        environment: &dyn Environment,
        update: Update,
        random: &mut Random,
        batch: usize,
    ) -> Option<UpdateReport> {
        match self {
            Self::Steps(replay) => Some(learner.update(replay, environment, update, random)),
            Self::Episodes(episodes) if episodes.finished() < batch as u64 => None,
            Self::Episodes(episodes) => {
                Some(learner.update_from_episodes(episodes, environment, update, random))
            }
        }
    }

    /// Names all of it.
    pub(super) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        match self {
            Self::Steps(replay) => state.value("replay", replay),
            Self::Episodes(episodes) => state.value("episodes", episodes),
        }
    }
}
