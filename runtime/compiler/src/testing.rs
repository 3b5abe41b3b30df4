//! Random networks, and what they compute by the book: plain loops in f64.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_bundle::OwnedObservation;
use sortie_core::NO_ACTION;
use sortie_core::plan::{Network, Profile};

use crate::assemble::{Origin, assemble};
use crate::lower::{AgentSizes, lower_agent};
use crate::matching::{AgentLayers, Layer, Matrix};

/// The shape of a random network.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub(crate) n_max: usize,
    pub(crate) features: usize,
    pub(crate) actions: usize,
    pub(crate) last_action: bool,
    pub(crate) width: usize,
    pub(crate) heads: usize,
    pub(crate) base: usize,
}

pub(crate) struct Random(Xoshiro256PlusPlus);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    pub(crate) fn below(&mut self, bound: usize) -> usize {
        self.0.next_u32() as usize % bound
    }

    /// A number in [-bound, bound].
    pub(crate) fn uniform(&mut self, bound: f32) -> f32 {
        ((self.0.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0) * bound
    }

    pub(crate) fn shape(&mut self) -> Shape {
        let heads = 1 + self.below(8);
        let steps = if heads.is_power_of_two() { 8 } else { 8 * heads };
        Shape {
            n_max: 1 + self.below(32),
            features: 1 + self.below(80),
            actions: 1 + self.below(20),
            last_action: self.below(2) == 0,
            width: steps * (1 + self.below(256 / steps)),
            heads,
            base: 8 * (1 + self.below(16)),
        }
    }

    fn matrix(&mut self, inputs: usize, outputs: usize) -> Matrix {
        let bound = 1.5 / (inputs as f32).sqrt();
        let values = (0..inputs * outputs).map(|_| self.uniform(bound)).collect();
        Matrix { inputs, outputs, values }
    }

    fn layer(&mut self, inputs: usize, outputs: usize, relu: bool) -> Layer {
        let matrix = self.matrix(inputs, outputs);
        let bias = (0..outputs).map(|_| self.uniform(0.5)).collect();
        Layer { matrix, bias, relu }
    }

    pub(crate) fn layers(&mut self, shape: Shape) -> AgentLayers {
        let last_action = if shape.last_action { shape.actions } else { 0 };
        let (width, base) = (shape.width, shape.base);
        let relu = self.below(2) == 0;
        AgentLayers {
            embed: self.layer(shape.features + last_action, width, true),
            heads: shape.heads,
            query: self.layer(width, width, false),
            key: self.matrix(width, width),
            value: self.matrix(width, width),
            output: self.layer(width, width, relu),
            dense: vec![self.layer(width, base, true), self.layer(base, shape.actions, false)],
        }
    }
}

/// The plan of a random network.
pub(crate) fn plan(layers: &AgentLayers, shape: Shape) -> Vec<u8> {
    let Shape { n_max, features, actions, .. } = shape;
    let sizes = AgentSizes { n_max, features, actions };
    let (program, weights) = lower_agent(layers, sizes).unwrap();
    let origin = Origin {
        source: [0; 32],
        profile: Profile::Exact,
        network: Network::Agent,
        contract: 0,
        t_max: 0,
        max_error: 0.0,
        action_mismatch: 0.0,
    };
    assemble(&program, &weights, sizes, &origin)
}

/// The utilities of the plain form of the network, in f64.
pub(crate) fn reference(layers: &AgentLayers, observation: &OwnedObservation) -> Vec<f64> {
    let columns = layers.embed.matrix.inputs;
    let embedding = |entity: usize| {
        let row = &observation.rows[entity * observation.features..][..observation.features];
        let mut input: Vec<f64> = row.iter().map(|&value| f64::from(value)).collect();
        input.resize(columns, 0.0);
        match observation.last_actions.get(entity) {
            Some(&action) if columns > observation.features && action != NO_ACTION => {
                input[observation.features + usize::from(action)] = 1.0;
            }
            _ => {}
        }
        apply(&layers.embed, &input)
    };
    let own = apply(&layers.query, &embedding(observation.self_index));
    let visible: Vec<Vec<f64>> = observation.visible.iter().map(embedding).collect();
    let head = own.len() / layers.heads;
    let keys: Vec<Vec<f64>> = visible.iter().map(|x| product(&layers.key, x)).collect();
    let values: Vec<Vec<f64>> = visible.iter().map(|x| product(&layers.value, x)).collect();
    let mut attended = vec![0.0; own.len()];
    for start in (0..own.len()).step_by(head) {
        let range = start..start + head;
        let dot = |key: &Vec<f64>| {
            own[range.clone()].iter().zip(&key[range.clone()]).map(|(a, b)| a * b).sum::<f64>()
        };
        let scores: Vec<f64> = keys.iter().map(dot).collect();
        let largest = scores.iter().copied().fold(f64::MIN, f64::max);
        let total: f64 = scores.iter().map(|score| (score - largest).exp()).sum();
        for (score, value) in scores.iter().zip(&values) {
            let weight = (score - largest).exp() / total;
            let parts = attended[range.clone()].iter_mut().zip(&value[range.clone()]);
            parts.for_each(|(sum, value)| *sum += weight * value);
        }
    }
    let output = apply(&layers.output, &attended);
    layers.dense.iter().fold(output, |input, layer| apply(layer, &input))
}

fn apply(layer: &Layer, input: &[f64]) -> Vec<f64> {
    let sums = product(&layer.matrix, input);
    let sums = sums.iter().zip(&layer.bias).map(|(sum, &bias)| sum + f64::from(bias));
    sums.map(|sum| if layer.relu { sum.max(0.0) } else { sum }).collect()
}

fn product(matrix: &Matrix, input: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; matrix.outputs];
    for (value, row) in input.iter().zip(matrix.values.chunks(matrix.outputs)) {
        sums.iter_mut().zip(row).for_each(|(sum, &weight)| *sum += value * f64::from(weight));
    }
    sums
}
