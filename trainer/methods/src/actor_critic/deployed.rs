//! Policies as they are deployed: graphs over an agent's own row, one for each group, with what is done to inputs taken into
//! the first layer; and the trainer's own forward pass beside them.

use sortie_core::{DecideError, Observation};
use sortie_learn::export::{
    DenseLayer, DeployedAgents, DeployedNetworks, OwnRowNetwork, OwnRowNetworks,
};
use sortie_learn::networks::OwnPass;
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::tape::Tape;

use super::acting::{Actors, scores_of};

/// The agents that these policies are, in teams with so many actions.
pub(crate) fn deployed(actors: Actors<'_>, actions: usize) -> DeployedAgents<'_> {
    let mut tape = Tape::default();
    let utilities = move |seen: &Observation<'_>, _: &mut [f32]| {
        let agent = seen.self_index;
        let row = seen.rows.get(agent * seen.stride..).unwrap_or_default();
        let scores = scores_of(actors, &mut tape, agent, row);
        let mut scores = scores.ok_or(DecideError::BadLength)?;
        scores.resize(actions, 0.0);
        Ok(scores)
    };
    let networks = DeployedNetworks::OwnRow(networks(actors));
    DeployedAgents { networks, policy: Box::new(OwnPass { actions, memory: 0, utilities }) }
}

/// The layers of policies that act. What is done to their inputs is folded into the first.
fn networks(actors: Actors<'_>) -> OwnRowNetworks {
    let (mut network_of, mut networks) = (Vec::new(), Vec::new());
    let Actors { groups, policies, head, weights, .. } = actors;
    for (index, group) in groups.0.iter().enumerate() {
        let mut layers = policies.layers(index, head).map(|layer| DenseLayer::of(layer, weights));
        fold(actors, index, &mut layers[0]);
        network_of.resize(group.agents.end, index);
        networks.push(OwnRowNetwork { features: group.observed, layers: layers.into() });
    }
    OwnRowNetworks { slope: policies.slope, network_of, networks }
}

/// Takes into a group's first layer what becomes of each of its inputs: a factor times it, and an offset.
fn fold(actors: Actors<'_>, index: usize, layer: &mut DenseLayer) {
    let group = &actors.groups.0[index];
    let column = |column: usize| match actors.inputs.running {
        Some(running) => {
            let factor = 1.0 / (running.variances[index][column] + f64::from(EPSILON)).sqrt();
            [factor, -factor * running.means[index][column]]
        }
        None if column < group.observed => [f64::from(actors.inputs.scale), 0.0],
        None => [1.0, 0.0],
    };
    let columns: Vec<[f64; 2]> = (0..group.inputs()).map(column).collect();
    for (row, bias) in layer.weight.chunks_exact_mut(layer.inputs).zip(&mut layer.bias) {
        let mut sum = f64::from(*bias);
        for (weight, [factor, offset]) in row.iter_mut().zip(&columns) {
            sum += f64::from(*weight) * offset;
            *weight = (f64::from(*weight) * factor) as f32;
        }
        *bias = sum as f32;
    }
}
