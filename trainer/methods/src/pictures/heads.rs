//! Numbers of a head that are values of actions.

use sortie_core::options;

use super::network::Network;

/// A value and advantages of all actions for each goal (Wang et al. 2016).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heads {
    pub(crate) goals: usize,
    pub(crate) actions: usize,
}

impl Heads {
    pub(crate) fn outputs(self) -> usize {
        self.goals * (1 + self.actions)
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
        let first = self.goals + goal * self.actions;
        values.clear();
        values.resize(1 + self.actions, 0.0);
        let outputs = std::iter::once(goal).chain(first..first + self.actions);
        network.read(weights, hidden, outputs, values);
        let value = values.remove(0);
        let level = value - values.iter().sum::<f32>() / self.actions as f32;
        values.iter_mut().for_each(|advantage| *advantage += level);
    }

    /// The value of one action, of all numbers of a row.
    pub(crate) fn value(self, row: &[f32], goal: usize, action: usize) -> f32 {
        let advantages = &row[self.goals + goal * self.actions..][..self.actions];
        row[goal] + advantages[action] - advantages.iter().sum::<f32>() / self.actions as f32
    }

    /// Adds the slopes of all numbers of a row by that of the value of one action.
    pub(crate) fn add_slope(self, slopes: &mut [f32], goal: usize, action: usize, slope: f32) {
        slopes[goal] += slope;
        let advantages = &mut slopes[self.goals + goal * self.actions..][..self.actions];
        advantages.iter_mut().for_each(|advantage| *advantage -= slope / self.actions as f32);
        advantages[action] += slope;
    }
}

/// The first of the largest numbers among those that a mask holds.
pub(crate) fn best(values: &[f32], mask: u32) -> usize {
    options::best(values, |index| mask >> index & 1 == 1).unwrap_or(0)
}
