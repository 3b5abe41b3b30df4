//! Where steps of the way back put the slopes by their inputs: in the place of nothing, or added to those of other steps.

use std::mem;
use std::ops::Range;

use super::{Indices, Tape, Var};
use crate::layers::elementwise;
use crate::layers::matrix::Store;

impl Tape {
    /// Has `write` store the slopes by `x`, from all values before the step, its results and its slopes.
    pub(super) fn from(
        &mut self,
        x: Var,
        own: Range<usize>,
        write: impl FnOnce(Store, &[f32], &[f32], &[f32], &mut [f32]),
    ) {
        let Some((range, store)) = self.slopes_of(x) else { return };
        let (before, rest) = self.slopes.split_at_mut(own.start);
        let (values, results) = self.values.split_at(own.start);
        write(store, values, &results[..own.len()], &rest[..own.len()], &mut before[range]);
    }

    /// Has `write` make slopes by inputs of those by the results, in so much space besides.
    ///
    /// They are written where they belong if nothing stands there yet.
    pub(super) fn descend_into<const N: usize>(
        &mut self,
        inputs: [Var; N],
        space: usize,
        own: Range<usize>,
        write: impl FnOnce(&mut Self, &[f32], [&mut [f32]; N], &mut [f32]),
    ) {
        let mut places = [const { None }; N];
        for (place, x) in places.iter_mut().zip(inputs).rev() {
            *place = self.slopes_of(x);
        }
        let are_empty = places.iter().all(|place| matches!(place, Some((_, Store::Replace))));
        let ranges = inputs.map(|x| self.of(x).range());
        let (mut slopes, mut scratch) = (mem::take(&mut self.slopes), mem::take(&mut self.scratch));
        let (before, rest) = slopes.split_at_mut(own.start);
        let numbers = if are_empty { 0 } else { ranges.iter().map(Range::len).sum() };
        let (space, mut rest_of_space) = sized(&mut scratch, space + numbers).split_at_mut(space);
        if are_empty {
            let d_x = before.get_disjoint_mut(ranges).expect("inputs apart from each other");
            write(self, &rest[..own.len()], d_x, space);
        } else {
            let part = |range: Range<usize>| rest_of_space.split_off_mut(..range.len());
            let mut computed = ranges.map(part).map(|part| part.expect("room for all inputs"));
            write(self, &rest[..own.len()], computed.each_mut().map(|d_x| &mut **d_x), space);
            for (place, computed) in places.into_iter().zip(&computed).rev() {
                if let Some((range, store)) = place {
                    elementwise::scale(1.0, computed, store, &mut before[range]);
                }
            }
        }
        (self.slopes, self.scratch) = (slopes, scratch);
    }

    /// Has `turn` make slopes by `x` of those by the results, from input and results.
    pub(super) fn through(
        &mut self,
        x: Var,
        own: Range<usize>,
        turn: impl FnOnce(&[f32], &[f32], &mut [f32]),
    ) {
        let (range, results) = (self.of(x).range(), own.clone());
        self.descend_into([x], 0, own, |tape, d_y, [d_x], _| {
            d_x.copy_from_slice(d_y);
            turn(&tape.values[range], &tape.values[results], d_x);
        });
    }

    /// Has `turn` make slopes by a row of `x` of those by a row of the results, from that row.
    pub(super) fn through_rows(
        &mut self,
        x: Var,
        own: Range<usize>,
        turn: impl Fn(&[f32], &mut [f32]),
    ) {
        let columns = self.columns(x);
        self.through(x, own, |_, y, d_x| {
            let rows = y.chunks_exact(columns).zip(d_x.chunks_exact_mut(columns));
            rows.for_each(|(y, d_x)| turn(y, d_x));
        });
    }

    /// Has `add` add to the slopes by `x`, from indices and the slopes by the results.
    pub(super) fn added(
        &mut self,
        x: Var,
        indices: Indices,
        own: Range<usize>,
        add: impl FnOnce(&[u32], &[f32], &mut [f32]),
    ) {
        let Some((range, store)) = self.slopes_of(x) else { return };
        let (before, rest) = self.slopes.split_at_mut(own.start);
        let d_x = &mut before[range];
        if store == Store::Replace {
            d_x.fill(0.0);
        }
        add(&self.indices[indices.0 as usize..indices.1 as usize], &rest[..own.len()], d_x);
    }
}

/// The first so many numbers of a buffer that only grows.
pub(super) fn sized(buffer: &mut Vec<f32>, numbers: usize) -> &mut [f32] {
    if buffer.len() < numbers {
        buffer.resize(numbers, 0.0);
    }
    &mut buffer[..numbers]
}
