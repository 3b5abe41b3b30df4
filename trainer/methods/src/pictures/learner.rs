//! Weights that follow a gradient, with those that targets are computed by and those that are measured.

use sortie_envs::Random;
use sortie_learn::configuration::OptimiserConfig;
use sortie_learn::run::UpdateReport;
use sortie_learn::state::Tensor;
use sortie_learn::{LearnError, State};
use sortie_nn::optimise::{Adam, clip_norm, move_towards};

use super::network::{Network, NetworkShape};
use crate::actor_critic::step::Step;

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
        let step =
            Step { rate: learning_rate, decay, epsilon: config.epsilon, early_epsilon: false };
        step.take(&mut self.adam, &mut self.online, &self.gradient);
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
