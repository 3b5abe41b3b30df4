//! What an agent's network attends to, for people who look at its decisions: on a host and in a browser.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod layers;

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use sortie_core::{DecideError, NO_ACTION, Observation};

pub use layers::{Layer, Matrix};

/// The layers of an agent's network that give its attention.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AttentionLayers {
    /// Entities to embeddings.
    pub embed: Layer,
    /// Attention heads.
    pub heads: usize,
    /// Own embedding to queries, the scale of the scores included.
    pub query: Layer,
    /// Embeddings to keys.
    pub key: Matrix,
}

/// Computes attention weights, which the graph of an agent does not give.
///
/// It computes the scores of the network's layers once more, slowly and allocating.
#[derive(Clone, Debug)]
pub struct AttentionProbe {
    layers: AttentionLayers,
    features: usize,
}

impl AttentionProbe {
    /// `features` is the number d of columns before the last action's one-hot.
    pub fn new(layers: AttentionLayers, features: usize) -> Self {
        Self { layers, features }
    }

    /// Attention heads.
    pub fn heads(&self) -> usize {
        self.layers.heads
    }

    /// The weights `[visible, heads]`, entities in rising order; those of one head sum to 1.
    pub fn weights(&self, observation: &Observation<'_>) -> Result<Vec<f32>, DecideError> {
        let heads = self.heads();
        let own = self.embed(observation, observation.self_index)?;
        let query = self.layers.query.apply(&own);
        let mut weights = Vec::new();
        for entity in observation.visible.iter() {
            let key = self.layers.key.apply(&self.embed(observation, entity)?);
            let width = key.len() / heads.max(1);
            let parts = query.chunks_exact(width).zip(key.chunks_exact(width));
            weights.extend(parts.map(|(q, k)| q.iter().zip(k).map(|(q, k)| q * k).sum::<f32>()));
        }
        for head in 0..heads {
            softmax(weights.iter_mut().skip(head).step_by(heads).collect());
        }
        Ok(weights)
    }

    /// Every visible entity with its weights `[heads]`.
    ///
    /// # Errors
    /// The rows are shorter than the observation says.
    pub fn by_entity(
        &self,
        observation: &Observation<'_>,
    ) -> Result<Vec<(usize, Vec<f32>)>, DecideError> {
        let weights = self.weights(observation)?;
        let parts = weights.chunks_exact(self.heads()).map(<[f32]>::to_vec);
        Ok(observation.visible.iter().zip(parts).collect())
    }

    /// The embedding of an entity's row and last action.
    fn embed(&self, observation: &Observation<'_>, entity: usize) -> Result<Vec<f32>, DecideError> {
        let start = entity * observation.stride;
        let row = observation.rows.get(start..start + self.features);
        let mut input = row.ok_or(DecideError::BadLength)?.to_vec();
        input.resize(self.layers.embed.matrix.inputs, 0.0);
        let last_action = observation.last_actions.get(entity).filter(|&&last| last != NO_ACTION);
        if let Some(one_hot) =
            last_action.and_then(|last| input.get_mut(self.features + usize::from(*last)))
        {
            *one_hot = 1.0;
        }
        Ok(self.layers.embed.apply(&input))
    }
}

fn softmax(scores: Vec<&mut f32>) {
    let max = scores.iter().fold(f32::NEG_INFINITY, |max, score| max.max(**score));
    let sum: f32 = scores.iter().map(|score| libm::expf(**score - max)).sum();
    scores.into_iter().for_each(|score| *score = libm::expf(*score - max) / sum);
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;
    use sortie_core::EntityMask;

    #[test]
    fn weights_are_the_softmax_of_query_and_key_over_what_is_visible() {
        let identity = || Matrix { inputs: 2, outputs: 2, values: vec![1.0, 0.0, 0.0, 1.0] };
        let layer = || Layer { matrix: identity(), bias: vec![0.0; 2], relu: false };
        let layers = AttentionLayers { embed: layer(), heads: 2, query: layer(), key: identity() };
        let probe = AttentionProbe::new(layers, 2);
        let mut visible = EntityMask::first(3);
        visible.remove(1);
        let observation = Observation {
            rows: &[1.0, 2.0, 9.0, 9.0, 3.0, 1.0],
            stride: 2,
            last_actions: &[],
            visible,
            self_index: 0,
            available: &[1],
        };
        // Head 0 scores 1 and 3, head 1 scores 4 and 2.
        let low = 1.0 / (1.0 + libm::expf(2.0));
        let weights = probe.weights(&observation).unwrap();
        let wanted = [low, 1.0 - low, 1.0 - low, low];
        assert_eq!(weights.len(), 4);
        for (got, want) in weights.iter().zip(wanted) {
            assert!((got - want).abs() < 1e-6, "{weights:?}");
        }
        let attended = [(0, weights[..2].to_vec()), (2, weights[2..].to_vec())];
        assert_eq!(probe.by_entity(&observation).unwrap(), attended);
        let short = Observation { rows: &[1.0, 2.0], ..observation };
        assert_eq!(probe.weights(&short), Err(DecideError::BadLength));
    }
}
