//! Numbers of a head that are values of actions.

use sortie_core::options;

use super::network::Network;

/// A value and advantages of all actions for each goal (Wang et al. 2016).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heads {
    pub(crate) goals: usize,
    pub(crate) actions: usize,
    /// Whether a value of the state stands apart from advantages; values of actions stand for themselves otherwise.
    pub(crate) dueling: bool,
}

impl Heads {
    pub(crate) fn outputs(self) -> usize {
        self.goals * (usize::from(self.dueling) + self.actions)
    }

    /// Of a head whose actions are these goals.
    pub(crate) fn of_goals(self, dueling: bool) -> Self {
        Self { goals: 1, actions: self.goals, dueling }
    }

    /// Where the numbers of the actions begin.
    fn first(self, goal: usize) -> usize {
        goal * self.actions + if self.dueling { self.goals } else { 0 }
    }

    /// Values of all actions for one goal, of a hidden row.
    pub(crate) fn values(
        self,
        network: &Network,
        weights: &[f32],
        hidden: &[f32],
        goal: usize,
        values: &mut Vec<f32>,
    ) {
        let first = self.first(goal);
        values.clear();
        if !self.dueling {
            values.resize(self.actions, 0.0);
            network.read(weights, hidden, first..first + self.actions, values);
            return;
        }
        values.resize(1 + self.actions, 0.0);
        let outputs = std::iter::once(goal).chain(first..first + self.actions);
        network.read(weights, hidden, outputs, values);
        let value = values.remove(0);
        let level = value - values.iter().sum::<f32>() / self.actions as f32;
        values.iter_mut().for_each(|advantage| *advantage += level);
    }

    /// The value of one action, of all numbers of a row.
    pub(crate) fn value(self, row: &[f32], goal: usize, action: usize) -> f32 {
        let advantages = &row[self.first(goal)..][..self.actions];
        if !self.dueling {
            return advantages[action];
        }
        row[goal] + advantages[action] - advantages.iter().sum::<f32>() / self.actions as f32
    }

    /// Adds the slopes of all numbers of a row by that of the value of one action.
    pub(crate) fn add_slope(self, slopes: &mut [f32], goal: usize, action: usize, slope: f32) {
        let advantages = &mut slopes[self.first(goal)..][..self.actions];
        advantages[action] += slope;
        if self.dueling {
            advantages.iter_mut().for_each(|advantage| *advantage -= slope / self.actions as f32);
            slopes[goal] += slope;
        }
    }
}

/// The first of the largest numbers among those that a mask holds.
pub(crate) fn best(values: &[f32], mask: u32) -> usize {
    options::best(values, |index| mask >> index & 1 == 1).unwrap_or(0)
}
