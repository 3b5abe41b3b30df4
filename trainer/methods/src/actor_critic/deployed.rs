//! The agents as they are deployed: by graphs over an agent's own row, one for each group.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_learn::export::{
    DenseLayer, DeployedAgents, DeployedNetworks, OwnRowNetwork, OwnRowNetworks,
};
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::tape::Linear;

use super::acting::{Acting, Actors};

/// The agents that these policies are, in teams with so many actions.
pub(crate) fn deployed(actors: Actors<'_>, actions: usize) -> DeployedAgents<'_> {
    let policy = OwnPass { actors, acting: Acting::default(), actions };
    DeployedAgents {
        networks: DeployedNetworks::OwnRow(networks(actors)),
        policy: Box::new(policy),
    }
}

/// The policies' layers. What is done to their inputs is folded into the first.
fn networks(actors: Actors<'_>) -> OwnRowNetworks {
    let (mut network_of, mut networks) = (Vec::new(), Vec::new());
    for (index, layers) in actors.policies.layers(actors.head).enumerate() {
        let group = &actors.groups.0[index];
        let [mut first, second, last] = layers.map(|layer| dense(actors.weights, layer));
        Columns::of(actors, index).fold(&mut first);
        network_of.resize(group.agents.end, index);
        networks
            .push(OwnRowNetwork { features: group.observed, layers: vec![first, second, last] });
    }
    OwnRowNetworks { slope: actors.policies.slope(), network_of, networks }
}

/// What becomes of each input of a group's network: a factor times it, and an offset.
struct Columns(Vec<[f64; 2]>);

impl Columns {
    fn of(actors: Actors<'_>, index: usize) -> Self {
        let Actors { groups, inputs, running, .. } = actors;
        let group = &groups.0[index];
        let column = |column: usize| {
            if inputs.normalised {
                let factor = 1.0 / (running.variances[index][column] + f64::from(EPSILON)).sqrt();
                [factor, -factor * running.means[index][column]]
            } else if column < group.observed {
                [f64::from(inputs.scale), 0.0]
            } else {
                [1.0, 0.0]
            }
        };
        Self((0..group.inputs()).map(column).collect())
    }

    /// Takes factors and offsets into a layer behind them.
    fn fold(&self, layer: &mut DenseLayer) {
        let rows = layer.weight.chunks_exact_mut(layer.inputs).zip(&mut layer.bias);
        for (row, bias) in rows {
            let mut sum = f64::from(*bias);
            for (weight, [factor, offset]) in row.iter_mut().zip(&self.0) {
                sum += f64::from(*weight) * offset;
                *weight = (f64::from(*weight) * factor) as f32;
            }
            *bias = sum as f32;
        }
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
