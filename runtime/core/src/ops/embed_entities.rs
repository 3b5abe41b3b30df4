//! The first layer of an agent network, on the rows that the agent may see.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::team::{Member, Team};
use super::{Flag, LAYOUT_TILES, Linear, Place, Scratch, Sizes, places};
use crate::entity_mask::EntityMask;
use crate::kernels::Kernels;
use crate::kernels::mark::Marks;
use crate::kernels::product::Sparse;
use crate::policy::{DecideError, NO_ACTION, Observation};

/// `relu(W x + b)` of every visible entity and of the agent itself; invisible rows are never read.
///
/// The matrix has d inputs, and U more where the last action's one-hot is appended; the one-hot is one row
/// of weights and never materialised. Features that are zero are left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct EmbedEntities {
    /// The layer; inputs are features, then last actions.
    pub layer: Linear,
    /// Last actions U that follow the features among the inputs, or 0.
    pub last_actions: u32,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// Where the embeddings go: `[n_max + 1, padded outputs]`, the own row of an agent that does not see
    /// itself behind the visible ones.
    pub rows: Place,
}

impl Operator for EmbedEntities {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let inputs = u32::from(self.layer.inputs);
        let actions = self.last_actions;
        let rows = (u64::from(sizes.n_max) + 1).saturating_mul(self.layer.padded_outputs() as u64);
        self.layer.check(sizes)
            && inputs.checked_sub(actions) == Some(sizes.features)
            && (actions == 0 || actions == sizes.actions)
            && sizes.lists(u64::from(inputs))
            && sizes.holds(&self.rows)
            && u64::from(self.rows.len) == rows
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        visible * self.layer.multiply_adds()
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let matrix = self.layer.matrix(weights)?;
        let around = self.layer.around(weights, self.relu.is_set())?;
        let [rows] = places(scratch.floats, [&self.rows])?;
        let rows = rows.chunks_exact_mut(self.layer.padded_outputs());
        let visible = observation.visible;
        let own = observation.self_index;
        // The own row comes last where the agent does not see itself.
        let hidden = (!visible.contains(own)).then_some(own);
        (scratch.visible, scratch.own) = (visible.len(), visible.len());
        for ((slot, entity), row) in visible.iter().chain(hidden).enumerate().zip(rows) {
            if entity == own {
                scratch.own = slot;
            }
            let inputs = self.inputs(kernels, entity, observation, scratch.nonzeros)?;
            kernels.sparse_product(matrix, inputs, around, row);
        }
        Ok(())
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        self.rows == Place { offset: 0, len: shared }
    }

    /// As [`Self::run`] for all members of a team: a row that several see is embedded once.
    fn run_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        observations: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let matrix = self.layer.matrix(weights)?;
        let around = self.layer.around(weights, self.relu.is_set())?;
        let Team { rows, nonzeros, members, .. } = team;
        let own = |member: &Member| observations.get(member.index);
        let mut union = EntityMask::EMPTY;
        for observation in members.iter().filter_map(own) {
            union = union.or(&observation.visible);
            union.insert(observation.self_index);
        }
        let Some(frame) = members.first().and_then(own) else { return Ok(()) };
        let rows = rows.chunks_exact_mut(self.layer.padded_outputs());
        for ((slot, entity), row) in (0..).zip(union.iter()).zip(rows) {
            let inputs = self.inputs(kernels, entity, frame, nonzeros).ok();
            let embedded = inputs.map(|inputs| {
                kernels.sparse_product(matrix, inputs, around, row);
                slot
            });
            for member in members.iter_mut() {
                if let Some(observation) = observations.get(member.index) {
                    member.note(observation, entity, embedded);
                }
            }
        }
        Ok(())
    }
}

impl EmbedEntities {
    /// An entity's inputs that are not zero, its last action behind the features.
    #[inline(always)]
    fn inputs<'a>(
        &self,
        kernels: impl Kernels,
        entity: usize,
        observation: &Observation<'a>,
        marks: &'a mut [Marks],
    ) -> Result<Sparse<'a>, DecideError> {
        let features = u32::from(self.layer.inputs).saturating_sub(self.last_actions) as usize;
        let start = entity.saturating_mul(observation.stride);
        let row = observation.rows.get(start..start.saturating_add(features));
        let values = row.ok_or(DecideError::BadLength)?;
        if !kernels.mark(values, marks) {
            return Err(DecideError::NonFinite);
        }
        let action = last_action(self.last_actions, entity, observation)?;
        let one = action.map(|action| features + usize::from(action));
        Ok(Sparse { values, marks, one, count: usize::from(self.layer.inputs) })
    }
}

/// An entity's last action, if the network takes `last_actions` and there was one.
#[inline(always)]
pub(super) fn last_action(
    last_actions: u32,
    entity: usize,
    observation: &Observation<'_>,
) -> Result<Option<u16>, DecideError> {
    match observation.last_actions.get(entity) {
        Some(&action) if last_actions > 0 && action != NO_ACTION => {
            (u32::from(action) < last_actions).then_some(Some(action)).ok_or(DecideError::BadLength)
        }
        _ => Ok(None),
    }
}
