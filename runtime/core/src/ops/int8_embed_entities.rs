//! The first layer of an agent network with int8 weights, on the rows that the agent may see.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::embed_entities::last_action;
use super::int8_layer::{Int8Layer, integers, quantised_floats};
use super::int8_rows::{RowsMut, rows_floats};
use super::operator::Operator;
use super::team::{Member, Team};
use super::{Flag, LAYOUT_INT8, Place, Scratch, Sizes, places};
use crate::entity_mask::EntityMask;
use crate::kernels::Kernels;
use crate::kernels::int8::{Matrix, Reach, SparseVector, row_max};
use crate::policy::{DecideError, Observation};

/// As [`super::EmbedEntities`]; every row of features is quantised by itself, as is its embedding, and pairs of inputs that are
/// both zero are left out. The matrix stores all outputs of a pair of inputs side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8EmbedEntities {
    /// The layer; inputs are features, then last actions.
    pub layer: Int8Layer,
    /// Last actions U that follow the features among the inputs, or 0.
    pub last_actions: u32,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// Where the embeddings go: n_max + 1 rows of integers, the own row of an agent that does not see itself behind the
    /// visible ones, then what an integer of each row counts.
    pub rows: Place,
    /// The quantised inputs of one row.
    pub quantised: Place,
    /// The embedding of one row, padded floats.
    pub embedded: Place,
}

impl Operator for Int8EmbedEntities {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        let inputs = u32::from(self.layer.inputs);
        let actions = self.last_actions;
        let rows = rows_floats(sizes.n_max, self.layer.outputs);
        self.layer.check(sizes)
            && inputs.checked_sub(actions) == Some(sizes.features)
            && (actions == 0 || actions == sizes.actions)
            && sizes.hold_apart(&[&self.rows, &self.quantised, &self.embedded])
            && u64::from(self.rows.len) == rows
            && self.embedded.len as usize == self.layer.padded_outputs()
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
        let wanted = [&self.rows, &self.quantised, &self.embedded];
        let [rows, quantised, embedded] = places(scratch.floats, wanted)?;
        let mut rows = RowsMut::new(rows, self.layer.outputs.into())?;
        let visible = observation.visible;
        let own = observation.self_index;
        // The own row comes last where the agent does not see itself.
        let hidden = (!visible.contains(own)).then_some(own);
        (scratch.visible, scratch.own) = (visible.len(), visible.len());
        for ((slot, entity), row) in visible.iter().chain(hidden).enumerate().zip(rows.iter()) {
            if entity == own {
                scratch.own = slot;
            }
            self.embed(kernels, &matrix, (entity, observation), [quantised, embedded], row)?;
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
        let wanted = [self.quantised, self.embedded].map(|place| team.own_place(&place));
        let Team { rows, own: floats, members, .. } = team;
        let mut room = places(floats, wanted.each_ref())?;
        let own = |member: &Member| observations.get(member.index);
        let mut union = EntityMask::EMPTY;
        for observation in members.iter().filter_map(own) {
            union = union.or(&observation.visible);
            union.insert(observation.self_index);
        }
        let Some(frame) = members.first().and_then(own) else { return Ok(()) };
        let mut rows = RowsMut::new(rows, self.layer.outputs.into())?;
        for ((slot, entity), row) in (0..).zip(union.iter()).zip(rows.iter()) {
            let room = room.each_mut().map(|floats| &mut **floats);
            let embedded = self.embed(kernels, &matrix, (entity, frame), room, row);
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
        [quantised, embedded]: [&mut [f32]; 2],
        (row, row_step): (&mut [i16], &mut f32),
    ) -> Result<(), DecideError> {
        let features = u32::from(self.layer.inputs).saturating_sub(self.last_actions) as usize;
        let start = entity.saturating_mul(observation.stride);
        let values = observation.rows.get(start..start.saturating_add(features));
        let values = values.ok_or(DecideError::BadLength)?;
        let integers = integers(quantised, self.layer.inputs.into())?;
        let action = last_action(self.last_actions, entity, observation)?;
        let one = action.map(|action| features + usize::from(action));
        let vector = SparseVector { values, one, integers, outputs: embedded };
        kernels.int8_sparse_product(matrix, vector).ok_or(DecideError::NonFinite)?;
        let outputs = embedded.get(..self.layer.outputs.into()).ok_or(DecideError::BadLength)?;
        let reach = Reach { least: 0.0, most: row_max(row.len()) };
        *row_step = kernels.quantise(outputs, reach, row).ok_or(DecideError::NonFinite)?.step;
        Ok(())
    }
}
