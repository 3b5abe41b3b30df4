//! The agents as they are deployed: by graphs over an agent's own row, one for each group.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_learn::export::{
    DenseLayer, DeployedAgents, DeployedNetworks, OwnRowNetwork, OwnRowNetworks,
};
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::tape::Linear;

use super::acting::{Acting, Actors};
use super::critic::SLOPE;

/// The agents that these policies are, in teams with so many actions.
pub(super) fn deployed(actors: Actors<'_>, actions: usize) -> DeployedAgents<'_> {
    let policy = OwnPass { actors, acting: Acting::default(), actions };
    DeployedAgents {
        networks: DeployedNetworks::OwnRow(networks(actors)),
        policy: Box::new(policy),
    }
}

/// The policies' layers. What is done to their inputs is folded into the first, and what an agent's number changes.
fn networks(actors: Actors<'_>) -> OwnRowNetworks {
    let (mut network_of, mut networks) = (Vec::new(), Vec::new());
    for (index, layers) in actors.policies.layers().enumerate() {
        let group = &actors.groups.0[index];
        let columns = Columns::of(actors, index);
        let [mut first, second, last] = layers.map(|layer| dense(actors.weights, layer));
        network_of.resize(group.agents.end, index);
        let of_agent = |place| columns.biases(&first, Some(group.observed + place));
        let told = if group.identity { group.agents.len() } else { 0 };
        let first_biases = (0..told).map(of_agent).collect();
        first.bias = columns.biases(&first, None);
        columns.fold(&mut first, group.observed);
        networks.push(OwnRowNetwork { layers: vec![first, second, last], first_biases });
    }
    OwnRowNetworks { slope: SLOPE, network_of, networks }
}

/// What becomes of each input of a group's network: a factor times it, and an offset.
struct Columns(Vec<[f64; 2]>);

impl Columns {
    fn of(actors: Actors<'_>, index: usize) -> Self {
        let Actors { groups, network, running, .. } = actors;
        let group = &groups.0[index];
        let column = |column: usize| {
            if network.normalised {
                let factor = 1.0 / (running.variances[index][column] + f64::from(EPSILON)).sqrt();
                [factor, -factor * running.means[index][column]]
            } else if column < group.observed {
                [f64::from(network.input_scale), 0.0]
            } else {
                [1.0, 0.0]
            }
        };
        Self((0..group.inputs()).map(column).collect())
    }

    /// The biases of a layer behind them where one input is 1, or none.
    fn biases(&self, layer: &DenseLayer, one: Option<usize>) -> Vec<f32> {
        let rows = layer.weight.chunks_exact(layer.inputs).zip(&layer.bias);
        let bias = |(row, bias): (&[f32], &f32)| {
            let inputs = row.iter().zip(&self.0).enumerate();
            let shown = inputs.map(|(column, (weight, [factor, offset]))| {
                let one = f64::from(u8::from(Some(column) == one));
                f64::from(*weight) * (factor * one + offset)
            });
            (f64::from(*bias) + shown.sum::<f64>()) as f32
        };
        rows.map(bias).collect()
    }

    /// Takes the factors into a layer behind them, and leaves out the inputs behind what is observed.
    fn fold(&self, layer: &mut DenseLayer, observed: usize) {
        let rows = layer.weight.chunks_exact(layer.inputs);
        let row = |row: &[f32]| {
            let weights = row.iter().zip(&self.0).take(observed);
            weights.map(|(weight, [factor, _])| (f64::from(*weight) * factor) as f32).collect()
        };
        layer.weight = rows.flat_map(|weights| -> Vec<f32> { row(weights) }).collect();
        layer.inputs = observed;
    }
}

fn dense(weights: &[f32], layer: Linear) -> DenseLayer {
    let [inputs, outputs] = [layer.shape.input, layer.shape.output];
    let part = |start: usize, length: usize| weights[start..start + length].to_vec();
    DenseLayer {
        inputs,
        weight: part(layer.weight, inputs * outputs),
        bias: layer.bias.map_or_else(|| vec![0.0; outputs], |start| part(start, outputs)),
    }
}

/// Decides with the trainer's own forward pass: what golden observations expect of every engine.
struct OwnPass<'a> {
    actors: Actors<'a>,
    acting: Acting,
    actions: usize,
}

impl Policy for OwnPass<'_> {
    fn actions(&self) -> usize {
        self.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let agent = observation.self_index;
        let row = observation.rows.get(agent * observation.stride..).unwrap_or_default();
        let scores = self.acting.look_from(self.actors, agent, row);
        let scores = scores.ok_or(DecideError::BadLength)?;
        utilities.fill(0.0);
        let known = utilities.get_mut(..scores.len()).ok_or(DecideError::BadLength)?;
        known.copy_from_slice(scores);
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = vec![0.0; self.actions];
        self.utilities(observation, &mut utilities)?;
        masked_argmax(&utilities, observation.available)
    }
}
