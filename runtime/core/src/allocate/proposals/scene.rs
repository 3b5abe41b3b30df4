//! What the three networks look at.

use super::memory::Grid;
use crate::allocator::{AllocateError, AllocationState};
use crate::entity_mask::EntityMask;
use crate::kernels::mark::{MARKED, Marks};
use crate::kernels::product::{Around, Sparse};
use crate::kernels::rows::Rows;
use crate::kernels::several::Pair;
use crate::kernels::softmax::slots;
use crate::kernels::{ATTENDED_WIDTH, HEADS, Heads, Kernels};
use crate::limits;
use crate::ops::proposal_arena::Extent;
use crate::ops::{Linear, ProposalNetwork, RowAttention};
use crate::policy::DecideError;

/// Marks of a row of features.
pub(super) type RowMarks = [Marks; limits::FEATURES / MARKED];

/// Rows that are multiplied with a matrix in one go.
const TOGETHER: usize = 256;

/// The state, and the networks with their weights.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) state: &'a AllocationState<'a>,
    pub(super) network: &'a ProposalNetwork,
    pub(super) weights: &'a [f32],
    pub(super) extent: Extent,
    /// The entities that exist.
    pub(super) present: EntityMask,
}

impl Scene<'_> {
    /// Subtasks that the networks know; those behind the state's are closed.
    pub(super) fn tasks(&self) -> usize {
        self.network.trunk.task_count()
    }

    /// The subtasks that an entity belongs to; of an agent its last one.
    pub(super) fn tasks_of(&self, entity: usize) -> u32 {
        let known = 1_u64.checked_shl(self.state.tasks as u32).map_or(u64::MAX, |bit| bit - 1);
        self.state.entity_task.get(entity).map_or(0, |tasks| tasks & known as u32)
    }

    /// The agents that exist, in the order in which they choose.
    pub(super) fn present_agents(&self) -> impl DoubleEndedIterator<Item = usize> + '_ {
        (0..self.state.agents).filter(|agent| self.present.contains(*agent))
    }

    /// Entities of a subtask that are no agents, present or not.
    pub(super) fn others_of(&self, task: usize) -> usize {
        let others = self.state.agents..self.extent.entities;
        others.filter(|entity| self.tasks_of(*entity) >> task & 1 == 1).count()
    }

    /// The features of an entity, checked and marked.
    pub(super) fn features<'m>(
        &self,
        kernels: impl Kernels,
        entity: usize,
        marks: &'m mut RowMarks,
    ) -> Result<Sparse<'m>, AllocateError>
    where
        Self: 'm,
    {
        let count = usize::from(self.network.trunk.embed.inputs);
        let start = entity.saturating_mul(self.state.stride);
        let row = self.state.rows.get(start..start.saturating_add(count));
        let values = row.ok_or(AllocateError::BadLength)?;
        if !kernels.mark(values, marks) {
            return Err(AllocateError::NonFinite);
        }
        Ok(Sparse { values, marks, one: None, count })
    }
}

/// The numbers of the subtasks in a set.
pub(super) fn tasks_in(mut set: u32) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let task = (set != 0).then(|| set.trailing_zeros() as usize)?;
        set &= set - 1;
        Some(task)
    })
}

/// The vector of this number among vectors of `width`; empty where there is none.
#[inline(always)]
pub(super) fn vector(vectors: &[f32], width: usize, number: usize) -> &[f32] {
    let start = number.saturating_mul(width);
    vectors.get(start..start.saturating_add(width)).unwrap_or(&[])
}

/// Adds a vector.
#[inline(always)]
pub(super) fn add(sums: &mut [f32], vector: &[f32]) {
    for (sum, value) in sums.iter_mut().zip(vector) {
        *sum += value;
    }
}

/// What is wrong, in an allocator's words.
pub(super) fn refused(error: DecideError) -> AllocateError {
    match error {
        DecideError::TooManyEntities { .. } => AllocateError::TooLarge,
        DecideError::NonFinite => AllocateError::NonFinite,
        _ => AllocateError::BadLength,
    }
}

/// A layer, ready to be multiplied with rows.
#[derive(Clone, Copy)]
pub(super) struct Product<'w> {
    matrix: &'w [f32],
    around: Around<'w>,
    inputs: usize,
    outputs: usize,
    sparse: bool,
}

impl<'w> Product<'w> {
    pub(super) fn new(
        layer: &Linear,
        weights: &'w [f32],
        relu: bool,
    ) -> Result<Self, AllocateError> {
        let (inputs, outputs) = (usize::from(layer.inputs), layer.padded_outputs());
        let matrix = layer.matrix(weights).map_err(refused)?;
        Ok(Self {
            matrix,
            around: layer.around(weights, relu).map_err(refused)?,
            inputs,
            outputs,
            sparse: false,
        })
    }

    /// The same product of rows that come out of a ReLU: their zeros are left out.
    pub(super) fn behind_relu(self) -> Self {
        Self { sparse: true, ..self }
    }

    /// Multiplies the first `count` rows that are wanted, and writes each to the row of the same number.
    #[inline(always)]
    pub(super) fn rows(
        &self,
        kernels: impl Kernels,
        from: &Grid<'_, f32>,
        to: &mut [f32],
        to_width: usize,
        wanted: impl Iterator<Item = usize>,
    ) {
        let mut rows = to.chunks_exact_mut(to_width.max(1)).enumerate();
        let mut wanted = wanted;
        loop {
            let mut pairs = heapless::Vec::<Pair<'_>, TOGETHER>::new();
            for row in wanted.by_ref().take(TOGETHER) {
                let to = rows.find(|(number, _)| *number == row).map(|(_, to)| to);
                let outputs = to.and_then(|to| to.get_mut(..self.outputs));
                let inputs = from.row(row).get(..self.inputs);
                if let Some((inputs, outputs)) = inputs.zip(outputs) {
                    // There is room for as many.
                    let _ = pairs.push(Pair { inputs, outputs });
                }
            }
            if pairs.is_empty() {
                return;
            }
            if self.sparse {
                kernels.sparse_products(self.matrix, &mut pairs, self.around);
            } else {
                kernels.products(self.matrix, &mut pairs, self.around);
            }
        }
    }
}

/// The rows that are attended to.
#[derive(Clone, Copy)]
pub(super) struct Near<'n> {
    pub(super) attention: &'n RowAttention,
    /// Keys and values of all rows.
    pub(super) keys: &'n Grid<'n, f32>,
    pub(super) values: &'n Grid<'n, f32>,
    /// Which of them are near.
    pub(super) slots: &'n [u16],
}

impl Near<'_> {
    /// Attends with the queries of some rows, and writes what each attended to behind the one before.
    #[inline(always)]
    pub(super) fn attend<K: Kernels>(
        &self,
        kernels: K,
        queries: &Grid<'_, f32>,
        askers: &[u16],
        mixed: &mut [f32],
        scores: &mut Grid<'_, f32>,
    ) -> Result<(), AllocateError> {
        let row = queries.width.max(1);
        for (asker, mixed) in askers.iter().zip(mixed.chunks_exact_mut(row)) {
            copy(queries.row(usize::from(*asker)), mixed);
        }
        let width = self.attention.head_width();
        let fits = width.is_multiple_of(ATTENDED_WIDTH)
            && row.is_multiple_of(HEADS.saturating_mul(width))
            && self.slots.len() <= K::ATTENDED;
        let together = HEADS.saturating_mul(row);
        for several in mixed.chunks_mut(together) {
            if fits && several.len() == together {
                self.attend_together(kernels, row, several)?;
                continue;
            }
            for mixed in several.chunks_exact_mut(row) {
                self.attend_alone(kernels, mixed, scores)?;
            }
        }
        Ok(())
    }

    /// Makes of the queries of [`HEADS`] rows what they attend to.
    #[inline(always)]
    fn attend_together(
        &self,
        kernels: impl Kernels,
        row: usize,
        mixed: &mut [f32],
    ) -> Result<(), AllocateError> {
        let width = self.attention.head_width();
        let mut rows = mixed.chunks_exact_mut(row.max(1));
        let mut rows =
            [(); HEADS].map(|()| rows.next().unwrap_or_default().chunks_exact_mut(width));
        let mut next = |first: usize| {
            let [a, b, c, d] = &mut rows;
            let heads = [a, b, c, d].map(|row| row.next().unwrap_or_default());
            let [keys, values] = self.rows(first, width);
            Heads { heads, keys, values }
        };
        for first in (0..row).step_by(HEADS.saturating_mul(width)) {
            let [second, third, fourth] = [1, 2, 3].map(|head| first + head * width);
            let groups = &mut [next(first), next(second), next(third), next(fourth)];
            if !kernels.attend(groups, &[]) {
                return Err(AllocateError::NonFinite);
            }
        }
        Ok(())
    }

    /// Makes of one row's query what it attends to.
    #[inline(always)]
    fn attend_alone(
        &self,
        kernels: impl Kernels,
        mixed: &mut [f32],
        scores: &mut Grid<'_, f32>,
    ) -> Result<(), AllocateError> {
        let (width, count) = (self.attention.head_width(), self.slots.len());
        let scores = scores.cells.get_mut(..slots(count)).ok_or(AllocateError::BadLength)?;
        for (mixed, first) in mixed.chunks_exact_mut(width).zip((0..).step_by(width)) {
            let [keys, values] = self.rows(first, width);
            kernels.dots(mixed, keys, scores);
            if !kernels.softmax(scores, count) {
                return Err(AllocateError::NonFinite);
            }
            kernels.mix(scores, values, mixed);
        }
        Ok(())
    }

    /// The columns of one head.
    #[inline(always)]
    fn rows(&self, first: usize, width: usize) -> [Rows<'_>; 2] {
        [self.keys, self.values].map(|grid| {
            let floats = grid.cells.get(first..).unwrap_or(&[]);
            Rows { floats, width, stride: grid.width, slots: self.slots }
        })
    }
}

/// Copies as much as there is of both.
#[inline(always)]
pub(super) fn copy(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
