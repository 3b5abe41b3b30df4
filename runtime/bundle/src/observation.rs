//! An observation that owns its numbers.

use sortie_core::{EntityMask, Observation};

/// What one agent saw in one step, kept.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedObservation {
    /// Features `[N, features]`.
    pub rows: Vec<f32>,
    /// Columns d of a row.
    pub features: usize,
    /// Last action `[A]` of every agent, `NO_ACTION` where there was none.
    pub last_actions: Vec<u16>,
    /// The entities that the agent may attend to.
    pub visible: EntityMask,
    /// The agent's own row.
    pub self_index: usize,
    /// Availability mask `[U]`: 0 = not available.
    pub available: Vec<u16>,
}

impl OwnedObservation {
    /// The observation as policies take it.
    pub fn view(&self) -> Observation<'_> {
        Observation {
            rows: &self.rows,
            stride: self.features,
            last_actions: &self.last_actions,
            visible: self.visible,
            self_index: self.self_index,
            available: &self.available,
        }
    }

    /// A copy of an observation with `features` columns.
    pub fn copy_of(observation: &Observation<'_>, features: usize) -> Self {
        let rows = observation.rows.chunks(observation.stride.max(1));
        let rows = rows.flat_map(|row| row.iter().take(features)).copied().collect();
        Self {
            rows,
            features,
            last_actions: observation.last_actions.to_vec(),
            visible: observation.visible,
            self_index: observation.self_index,
            available: observation.available.to_vec(),
        }
    }

    /// Number of entity rows N.
    pub fn entities(&self) -> usize {
        self.rows.len().checked_div(self.features).unwrap_or(0)
    }
}
