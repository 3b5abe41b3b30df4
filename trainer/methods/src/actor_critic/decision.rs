//! Decisions that hold for some steps, and what they earn.

use serde::{Deserialize, Serialize};
use sortie_envs::Environment;

/// What an instance is doing.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Decision {
    /// `[agents]`
    pub(crate) actions: Vec<u16>,
    /// Steps that it holds for.
    pub(crate) left: usize,
    /// `[agents]`: what each has earned by it.
    pub(crate) rewards: Vec<f32>,
    /// What a reward of the next step counts.
    pub(crate) discount: f32,
    /// How near each agent was to what it is after.
    potentials: Vec<f32>,
}

impl Decision {
    /// Begins another one, of so many agents, that holds for so many steps.
    pub(crate) fn begin(&mut self, agents: usize, steps: usize) {
        self.actions.resize(agents, 0);
        self.left = steps;
        self.rewards.clear();
        self.rewards.resize(agents, 0.0);
        self.discount = 1.0;
    }

    /// Adds what a step brought.
    pub(crate) fn earn(&mut self, rewards: &[f64], discount: f32) {
        for (sum, reward) in self.rewards.iter_mut().zip(rewards) {
            *sum += self.discount * *reward as f32;
        }
        self.discount *= discount;
    }

    /// Looks how near each agent is to what it is after, by which rewards are shaped on this scale.
    pub(crate) fn look(&mut self, environment: &dyn Environment, state: &[u8], scale: f32) {
        let near = |agent: usize| environment.potential(state, scale, 1 << agent, None);
        let agents = 0..self.rewards.len();
        self.potentials.clear();
        self.potentials.extend(agents.map(|agent| if scale == 0.0 { 0.0 } else { near(agent) }));
    }

    /// Adds how much nearer each agent came since it last looked.
    pub(crate) fn shape(&mut self, environment: &dyn Environment, state: &[u8], scale: f32) {
        let before = std::mem::take(&mut self.potentials);
        self.look(environment, state, scale);
        for ((sum, before), after) in self.rewards.iter_mut().zip(before).zip(&self.potentials) {
            *sum += self.discount * *after - before;
        }
    }
}
