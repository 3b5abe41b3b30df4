//! Forward and backward passes of coach, recognition network and players over many states at once.
//!
//! The first two give rows `[agents, 2 R]`: the mean of every number of a strategy, then the logarithm of its
//! variance. A player is a utility network with a strategy added before its head.

use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use sortie_nn::layers::{linear, relu};

use super::gaussian;
use super::networks::{Coach, Recognition, TrunkPass};
use crate::alma::agents::{UtilityInput, UtilityNetwork, UtilityPass};
use crate::sized;

/// Buffers of one worker for passes of a coach.
#[derive(Clone, Debug, Default)]
pub struct CoachPass {
    trunk: TrunkPass,
    rows: Vec<f32>,
    d_looked: Vec<f32>,
}

impl CoachPass {
    /// Computes means and logarithms of variances `[agents, 2 R]`.
    pub fn forward(&mut self, coach: &Coach, input: &UtilityInput) -> &[f32] {
        let shape = coach.shape();
        let (trunk, head) = coach.parameters().split_at(shape.trunk().parameters());
        let looked = self.trunk.forward(shape.trunk(), trunk, input);
        let (weight, bias) = head.split_at(head.len() - shape.head().output);
        let rows = sized(&mut self.rows, input.visible.queries() * shape.head().output);
        linear::forward(shape.head(), looked, weight, bias, rows);
        gaussian::clamp(shape.strategy, rows);
        rows
    }

    /// Adds the gradient of a loss whose slope by what the last forward pass gave is `d_rows`, which is
    /// clamped in place.
    pub fn backward(
        &mut self,
        coach: &Coach,
        input: &UtilityInput,
        d_rows: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (shape, queries) = (coach.shape(), input.visible.queries());
        gaussian::clamp_backward(shape.strategy, &self.rows[..d_rows.len()], d_rows);
        let (trunk, head) = coach.parameters().split_at(shape.trunk().parameters());
        let (d_trunk, d_head) = gradient.split_at_mut(trunk.len());
        let weights = head.len() - shape.head().output;
        let (d_weight, d_bias) = d_head.split_at_mut(weights);
        let looked = self.trunk.looked(shape.trunk(), queries);
        linear::backward_weight(shape.head(), looked, d_rows, d_weight);
        linear::backward_bias(d_rows, d_bias);
        let d_looked = sized(&mut self.d_looked, queries * shape.width);
        let weight = &head[..weights];
        linear::backward_input(shape.head(), d_rows, weight, Store::Replace, d_looked);
        self.trunk.backward(shape.trunk(), trunk, input, d_looked, d_trunk);
    }
}

/// Buffers of one worker for passes of a recognition network.
#[derive(Clone, Debug, Default)]
pub struct RecognitionPass {
    trunk: TrunkPass,
    /// `[agents, 2 E]`
    hidden: Vec<f32>,
    rows: Vec<f32>,
    d_hidden: Vec<f32>,
    d_looked: Vec<f32>,
}

impl RecognitionPass {
    /// Computes means and logarithms of variances `[agents, 2 R]`.
    pub fn forward(&mut self, network: &Recognition, input: &UtilityInput) -> &[f32] {
        let (shape, queries) = (network.shape(), input.visible.queries());
        let (width, strategy) = (shape.coach.width, shape.coach.strategy);
        let [trunk, weight, bias, last, last_bias] = parts(network);
        let looked = self.trunk.forward(shape.trunk(), trunk, input);
        let hidden = sized(&mut self.hidden, queries * 2 * width);
        linear::forward_rectified(shape.hidden(), looked, weight, bias, hidden);
        let rows = sized(&mut self.rows, queries * 2 * strategy);
        rows.chunks_exact_mut(2 * strategy).for_each(|row| row.copy_from_slice(last_bias));
        for (half, last) in last.chunks_exact(strategy * width).enumerate() {
            let narrow = half * strategy..(half + 1) * strategy;
            multiply(
                MatrixMut::new(rows, queries, 2 * strategy).columns(narrow),
                Store::Add,
                Matrix::new(hidden, queries, 2 * width).columns(half * width..(half + 1) * width),
                Matrix::new(last, strategy, width).transposed(),
            );
        }
        gaussian::clamp(strategy, rows);
        rows
    }

    /// Adds the gradient of a loss whose slope by what the last forward pass gave is `d_rows`, which is
    /// clamped in place.
    pub fn backward(
        &mut self,
        network: &Recognition,
        input: &UtilityInput,
        d_rows: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (shape, queries) = (network.shape(), input.visible.queries());
        let (width, strategy) = (shape.coach.width, shape.coach.strategy);
        gaussian::clamp_backward(strategy, &self.rows[..d_rows.len()], d_rows);
        let parts = parts(network);
        let [trunk, weight, _, last, _] = parts;
        let mut rest = gradient;
        let [d_trunk, d_weight, d_bias, d_last, d_last_bias] =
            parts.map(|part| rest.split_off_mut(..part.len()).expect("one slope per parameter"));
        linear::backward_bias(d_rows, d_last_bias);
        let hidden = &self.hidden[..queries * 2 * width];
        let d_hidden = sized(&mut self.d_hidden, hidden.len());
        let layers = last.chunks_exact(strategy * width);
        for (half, (last, d_last)) in
            layers.zip(d_last.chunks_exact_mut(strategy * width)).enumerate()
        {
            let (narrow, wide) =
                (half * strategy..(half + 1) * strategy, half * width..(half + 1) * width);
            let d_rows = Matrix::new(d_rows, queries, 2 * strategy).columns(narrow);
            let hidden = Matrix::new(hidden, queries, 2 * width).columns(wide.clone());
            let d_last = MatrixMut::new(d_last, strategy, width);
            multiply(d_last, Store::Add, d_rows.transposed(), hidden);
            multiply(
                MatrixMut::new(d_hidden, queries, 2 * width).columns(wide),
                Store::Replace,
                d_rows,
                Matrix::new(last, strategy, width),
            );
        }
        relu::backward(hidden, d_hidden);
        let looked = self.trunk.looked(shape.trunk(), queries);
        linear::backward_weight(shape.hidden(), looked, d_hidden, d_weight);
        linear::backward_bias(d_hidden, d_bias);
        let d_looked = sized(&mut self.d_looked, queries * width);
        linear::backward_input(shape.hidden(), d_hidden, weight, Store::Replace, d_looked);
        self.trunk.backward(shape.trunk(), trunk, input, d_looked, d_trunk);
    }
}

/// Trunk, hidden layers and their biases, last layers and their biases.
fn parts(network: &Recognition) -> [&[f32]; 5] {
    let shape = network.shape();
    let (hidden, last) = (shape.hidden(), shape.last());
    let mut rest = network.parameters();
    [
        shape.trunk().parameters(),
        hidden.output * hidden.input,
        hidden.output,
        2 * last.output * last.input,
        2 * last.output,
    ]
    .map(|length| rest.split_off(..length).expect("all tensors"))
}

/// Buffers of one worker for passes of players, beside those of their network.
#[derive(Clone, Debug, Default)]
pub struct PlayerPass {
    /// What stands before the head, `[agents, R]`.
    rows: Vec<f32>,
    d_rows: Vec<f32>,
    d_strategies: Vec<f32>,
}

impl PlayerPass {
    /// Computes the utilities `[agents, U]`, given every agent's strategy `[R]` in turn, if it has
    /// been told one.
    pub fn forward<'u, 's>(
        &mut self,
        network: &UtilityNetwork,
        utility: &'u mut UtilityPass,
        input: &UtilityInput,
        strategies: impl Iterator<Item = Option<&'s [f32]>>,
    ) -> &'u [f32] {
        let width = network.shape().base;
        let base = utility.forward_base(network, input);
        self.rows.clear();
        for (base, strategy) in base.chunks_exact(width).zip(strategies) {
            match strategy {
                Some(told) => self.rows.extend(base.iter().zip(told).map(|(x, z)| x + z)),
                None => self.rows.extend_from_slice(base),
            }
        }
        utility.forward_head(network, &self.rows)
    }

    /// Adds the gradient of a loss whose slope by the utilities of the last forward pass is given; returns
    /// its slope by the strategies, `[agents, R]`.
    pub fn backward(
        &mut self,
        network: &UtilityNetwork,
        utility: &mut UtilityPass,
        input: &UtilityInput,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) -> &[f32] {
        let Self { rows, d_rows, d_strategies } = self;
        d_rows.resize(rows.len(), 0.0);
        utility.backward_head(network, rows, d_utilities, d_rows, gradient);
        // The base is rectified, strategies are not.
        d_strategies.clone_from(d_rows);
        utility.backward_base(network, input, d_rows, gradient);
        d_strategies
    }
}
