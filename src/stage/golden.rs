//! What a bundle's agents were asked once, so that machines can be compared by their answers.

use alloc::vec;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use sortie_core::{EntityMask, Observation};

/// An observation of the bundle's golden cases, without zeros.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoldenObservation {
    /// `[N]`: columns and values of each row.
    rows: Vec<Vec<(u16, f32)>>,
    /// Columns of a row.
    features: u16,
    last_actions: Vec<u16>,
    visible: [u64; 2],
    self_index: u16,
    available: Vec<u16>,
}

impl GoldenObservation {
    /// What an agent saw; the first so many columns of a row count.
    pub fn new(observation: &Observation<'_>, features: usize) -> Self {
        let rows = observation.rows.chunks(observation.stride.max(1)).map(|row| {
            let values = (0_u16..).zip(row.iter().take(features).copied());
            values.filter(|(_, value)| value.to_bits() != 0).collect()
        });
        let [low, high] = [0, 1].map(|word| observation.visible.words().get(word).copied());
        Self {
            rows: rows.collect(),
            features: features as u16,
            last_actions: observation.last_actions.to_vec(),
            visible: [low.unwrap_or(0), high.unwrap_or(0)],
            self_index: observation.self_index as u16,
            available: observation.available.to_vec(),
        }
    }

    /// Its rows in full, for [`Self::view`].
    pub fn dense(&self) -> Vec<f32> {
        let features = usize::from(self.features);
        let mut dense = vec![0.0; self.rows.len() * features];
        for (row, to) in self.rows.iter().zip(dense.chunks_exact_mut(features.max(1))) {
            for (column, value) in row {
                if let Some(to) = to.get_mut(usize::from(*column)) {
                    *to = *value;
                }
            }
        }
        dense
    }

    /// As a policy takes it, over its rows in full.
    pub fn view<'a>(&'a self, dense: &'a [f32]) -> Observation<'a> {
        Observation {
            rows: dense,
            stride: self.features.into(),
            last_actions: &self.last_actions,
            visible: EntityMask::from_words(&self.visible),
            self_index: self.self_index.into(),
            available: &self.available,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_observation_comes_back_as_it_was() {
        let seen = Observation {
            rows: &[0.0, 1.5, 7.0, -0.0, 0.0, 7.0],
            stride: 3,
            last_actions: &[4],
            visible: EntityMask::from_words(&[0b10, 1]),
            self_index: 1,
            available: &[1, 0],
        };
        let kept = GoldenObservation::new(&seen, 2);
        let bytes = postcard::to_allocvec(&kept).expect("there is room");
        let kept: GoldenObservation = postcard::from_bytes(&bytes).expect("it comes back");
        let dense = kept.dense();
        let bits: Vec<u32> = dense.iter().map(|value| value.to_bits()).collect();
        assert_eq!(bits, [0.0, 1.5, -0.0_f32, 0.0].map(f32::to_bits));
        let view = kept.view(&dense);
        assert_eq!((view.stride, view.self_index, view.visible), (2, 1, seen.visible));
        assert_eq!((view.last_actions, view.available), (seen.last_actions, seen.available));
    }
}
