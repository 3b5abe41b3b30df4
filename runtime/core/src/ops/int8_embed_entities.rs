//! The first layer of an agent network with int8 weights, on the rows that the agent may see.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::embed_entities::last_action;
use super::int8_layer::{Int8Layer, integers, quantised_floats};
use super::operator::Operator;
use super::team::{Member, Team};
use super::{Flag, LAYOUT_INT8, Place, Scratch, Sizes, places};
use crate::entity_mask::EntityMask;
use crate::kernels::Kernels;
use crate::kernels::int8::{Matrix, SparseVector};
use crate::policy::{DecideError, Observation};

/// As [`super::EmbedEntities`]; every row is quantised by itself, and pairs of inputs that are both zero are left
/// out. The matrix stores all outputs of a pair of inputs side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8EmbedEntities {
    /// The layer; inputs are features, then last actions.
    pub layer: Int8Layer,
    /// Last actions U that follow the features among the inputs, or 0.
    pub last_actions: u32,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// Where the embeddings go: `[n_max + 1, padded outputs]`, the own row of an agent that does not see
    /// itself behind the visible ones.
    pub rows: Place,
    /// The quantised inputs of one row.
    pub quantised: Place,
}

impl Operator for Int8EmbedEntities {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        let inputs = u32::from(self.layer.inputs);
        let actions = self.last_actions;
        let rows = (u64::from(sizes.n_max) + 1).saturating_mul(self.layer.padded_outputs() as u64);
        self.layer.check(sizes)
            && inputs.checked_sub(actions) == Some(sizes.features)
            && (actions == 0 || actions == sizes.actions)
            && sizes.hold_apart(&[&self.rows, &self.quantised])
            && u64::from(self.rows.len) == rows
            && self.quantised.len as usize == quantised_floats(self.layer.inputs.into())
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        visible * self.layer.shape().multiply_adds()
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let matrix = self.layer.matrix(weights, self.relu.is_set())?;
        let [rows, quantised] = places(scratch.floats, [&self.rows, &self.quantised])?;
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
            self.embed(kernels, &matrix, (entity, observation), quantised, row)?;
        }
        Ok(())
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        // Its places do not overlap, and the first are the shared rows.
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
        let matrix = self.layer.matrix(weights, self.relu.is_set())?;
        let quantised = team.own_place(&self.quantised);
        let Team { rows, own: floats, members, .. } = team;
        let quantised = floats.get_mut(quantised.range()).ok_or(DecideError::BadLength)?;
        let own = |member: &Member| observations.get(member.index);
        let mut union = EntityMask::EMPTY;
        for observation in members.iter().filter_map(own) {
            union = union.or(&observation.visible);
            union.insert(observation.self_index);
        }
        let Some(frame) = members.first().and_then(own) else { return Ok(()) };
        let rows = rows.chunks_exact_mut(self.layer.padded_outputs());
        for ((slot, entity), row) in (0..).zip(union.iter()).zip(rows) {
            let embedded = self.embed(kernels, &matrix, (entity, frame), quantised, row);
            let slot = embedded.is_ok().then_some(slot);
            for member in members.iter_mut() {
                if let Some(observation) = observations.get(member.index) {
                    member.note(observation, entity, slot);
                }
            }
        }
        Ok(())
    }
}

impl Int8EmbedEntities {
    /// Embeds an entity's row, its last action behind the features.
    #[inline(always)]
    fn embed(
        &self,
        kernels: impl Kernels,
        matrix: &Matrix<'_>,
        (entity, observation): (usize, &Observation<'_>),
        quantised: &mut [f32],
        outputs: &mut [f32],
    ) -> Result<(), DecideError> {
        let features = u32::from(self.layer.inputs).saturating_sub(self.last_actions) as usize;
        let start = entity.saturating_mul(observation.stride);
        let row = observation.rows.get(start..start.saturating_add(features));
        let values = row.ok_or(DecideError::BadLength)?;
        let integers = integers(quantised, self.layer.inputs.into())?;
        let action = last_action(self.last_actions, entity, observation)?;
        let one = action.map(|action| features + usize::from(action));
        let vector = SparseVector { values, one, integers, outputs };
        kernels.int8_sparse_product(matrix, vector).ok_or(DecideError::NonFinite)
    }
}
