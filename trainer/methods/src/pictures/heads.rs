//! Numbers of a head that are values of actions, and weights that follow a gradient, with those that targets are computed
//! by and those that are measured.

use sortie_core::options;
use sortie_envs::Random;
use sortie_learn::configuration::OptimiserConfig;
use sortie_learn::run::UpdateReport;
use sortie_learn::state::Tensor;
use sortie_learn::{LearnError, State};
use sortie_nn::optimise::{Adam, AdamRules, clip_norm, move_towards};

use super::network::{Network, NetworkShape};

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

/// A network that learns.
#[derive(Clone, Debug)]
pub(crate) struct Learner {
    pub(crate) network: Network,
    pub(crate) online: Vec<f32>,
    pub(crate) target: Vec<f32>,
    pub(crate) average: Vec<f32>,
    pub(crate) gradient: Vec<f32>,
    adam: Adam,
}

impl Learner {
    /// Draws the first weights.
    pub(crate) fn new(
        shape: NetworkShape,
        optimiser: &OptimiserConfig,
        random: &mut Random,
    ) -> Self {
        let network = Network::new(shape, random);
        let weights = network.parameters.values.clone();
        Self {
            online: weights.clone(),
            target: weights.clone(),
            average: weights.clone(),
            gradient: vec![0.0; weights.len()],
            adam: Adam::new(weights.len(), optimiser.epsilon),
            network,
        }
    }

    /// Follows the gradient, which is forgotten; `decay` is what a weight adds to its slope.
    pub(crate) fn step(
        &mut self,
        config: &OptimiserConfig,
        learning_rate: f32,
        decay: f32,
        loss: f64,
    ) -> UpdateReport {
        let gradient_norm = clip_norm(&mut self.gradient, config.clip);
        let rules = AdamRules { epsilon: config.epsilon, early_epsilon: false, decay };
        self.adam.step_by(rules, &mut self.online, &self.gradient, learning_rate);
        self.gradient.fill(0.0);
        move_towards(&mut self.target, &self.online, config.target_rate);
        move_towards(&mut self.average, &self.online, config.average_rate);
        UpdateReport { loss, gradient_norm }
    }

    /// Targets are computed by the weights of today.
    pub(crate) fn copy_to_target(&mut self) {
        self.target.copy_from_slice(&self.online);
    }

    pub(crate) fn state(&mut self, state: &mut State<'_>, name: &str) -> Result<(), LearnError> {
        let tensors: Vec<Tensor> = self.network.parameters.tensors().to_vec();
        for (kind, vector) in [
            ("online", &mut self.online),
            ("target", &mut self.target),
            ("average", &mut self.average),
            ("adam-mean", &mut self.adam.mean),
            ("adam-square", &mut self.adam.square),
        ] {
            state.tensors(&format!("{name}/{kind}"), &tensors, vector)?;
        }
        state.value(&format!("{name}/adam-steps"), &mut self.adam.steps)
    }
}

#[cfg(test)]
mod tests {
    use sortie_core::options::PictureShape;
    use sortie_nn::gradient_check::{assert_gradient, random};

    use super::*;
    use crate::pictures::network::Body;

    #[test]
    fn values_of_a_row_of_numbers_and_of_a_hidden_row_are_the_same_and_have_their_slopes() {
        let picture = PictureShape { channels: 1, size: 7, counts: 1, crop: 7, nearest: false };
        for dueling in [true, false] {
            let heads = Heads { goals: 3, actions: 4, dueling };
            assert_eq!(heads.outputs(), if dueling { 15 } else { 12 });
            let (body, outputs) = (Body::Layers, heads.outputs());
            let shape = NetworkShape { body, picture, columns: 5, active: 5, width: 8, outputs };
            let mut generator = sortie_nn::random::stream(1, 1, 0);
            let network = Network::new(shape, &mut generator);
            let hidden = random(2, 8);
            let mut row = vec![0.0; outputs];
            let weights = &network.parameters.values;
            network.read(weights, &hidden, 0..outputs, &mut row);
            for goal in 0..3 {
                let mut values = Vec::new();
                heads.values(&network, weights, &hidden, goal, &mut values);
                let first = if dueling { 3 + 4 * goal } else { 4 * goal };
                let mean = row[first..first + 4].iter().sum::<f32>() / 4.0;
                for (action, value) in values.into_iter().enumerate() {
                    let level = if dueling { row[goal] - mean } else { 0.0 };
                    assert!((value - level - row[first + action]).abs() < 1e-6);
                    assert!((heads.value(&row, goal, action) - value).abs() < 1e-6);
                    let mut slopes = vec![0.0; outputs];
                    heads.add_slope(&mut slopes, goal, action, 0.5);
                    assert_gradient("value", &row, &slopes, |row| {
                        0.5 * f64::from(heads.value(row, goal, action))
                    });
                }
            }
        }
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0], 0b1101), 2);
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0], u32::MAX), 1);
    }
}
