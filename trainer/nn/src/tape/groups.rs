//! Steps by groups of rows, such as the agents of each team, and by what is seen in two parts.

use std::mem;
use std::ops::Range;

use super::backward::sized;
use super::{Indices, Operation, Pass, Tape, Var};
use crate::layers::matrix::Store;
use crate::layers::split_attention::{self, BLOCKS, HEADS};
use crate::layers::{VisibleLists, elementwise};
use sortie_core::internal::math::exp;

impl Pass<'_> {
    /// So many rows, each the mean of all rows i of `x` for which `to[i]` is its number; zeros where there is none.
    pub fn mean_by(&mut self, x: Var, to: &[u32], rows: usize) -> Var {
        let sums = self.scatter(x, to, rows);
        let shares = self.tape.push(Operation::Given, rows, 1, false);
        let (_, counts) = self.tape.split(shares);
        counts.fill(0.0);
        to.iter().for_each(|row| counts[*row as usize] += 1.0);
        counts.iter_mut().for_each(|count| *count = 1.0 / count.max(1.0));
        self.scale_rows(sums, shares)
    }

    /// The softmax of every column over each of so many groups: row i belongs to group `to[i]`.
    pub fn softmax_by(&mut self, x: Var, to: &[u32], groups: usize) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(rows, to.len(), "a group for every row");
        let indices = self.tape.store_indices(to.iter().copied());
        let operation = Operation::SoftmaxGroups { x, indices, groups: groups as u32 };
        let mut scratch = mem::take(&mut self.tape.scratch);
        let of_groups = sized(&mut scratch, groups * columns);
        let y = self.step(operation, x, [rows, columns], |x, y| {
            of_groups.fill(f32::NEG_INFINITY);
            by_group(to, columns, of_groups, x, |most, x| *most = most.max(*x));
            y.copy_from_slice(x);
            by_group_mut(to, columns, of_groups, y, |most, y| *y = exp(*y - most));
            of_groups.fill(0.0);
            by_group(to, columns, of_groups, y, |sum, y| *sum += y);
            by_group_mut(to, columns, of_groups, y, |sum, y| *y /= sum);
        });
        self.tape.scratch = scratch;
        y
    }

    /// What each query makes of the rows that it sees, in four heads, at a width of one of
    /// [`WIDTHS`](split_attention::WIDTHS). With `parts` there are three blocks `[3 * queries, width]`: of everything, of what
    /// lies within its part and of what lies across, as imagined passes need them (REFIL, dissertation section 5.4); no pair is
    /// looked at twice. Sizes as of [`attention`](Self::attention).
    pub fn split_attention(
        &mut self,
        queries: Var,
        keys_values: Var,
        lists: &VisibleLists,
        parts: bool,
    ) -> Var {
        let [count, width] = self.size(queries);
        assert_eq!((count, 2 * width), (lists.queries(), self.size(keys_values)[1]), "sizes");
        let (place, kept) = self.tape.lists.next();
        kept.copy_from(lists);
        let [pairs, shares] = [lists.pairs(), count].map(|rows| rows * HEADS);
        let start = self.tape.reserve(pairs + shares);
        let rows = if parts { BLOCKS * count } else { count };
        let needs = self.tape.needs(queries) || self.tape.needs(keys_values);
        let (weights, places) = (start as u32, (start + pairs) as u32);
        let operation =
            Operation::AttendSplit { queries, keys_values, lists: place, weights, shares: places };
        let y = self.tape.push(operation, rows, width, needs);
        let [queries, keys_values] = [queries, keys_values].map(|var| self.tape.of(var).range());
        let range = self.tape.of(y).range();
        let (before, rest) = self.tape.values.split_at_mut(start);
        let (space, rest) = rest.split_at_mut(range.start - start);
        let (weights, shares) = space.split_at_mut(pairs);
        let pass = split_attention::Forward {
            queries: &before[queries],
            keys_values: &before[keys_values],
            weights,
            shares,
            output: &mut rest[..rows * width],
        };
        split_attention::forward(width, lists, pass);
        y
    }
}

/// Has `each` join every number of `rows` with the number of its column for the row's group.
#[inline(always)]
fn by_group(
    to: &[u32],
    columns: usize,
    of_groups: &mut [f32],
    rows: &[f32],
    each: impl Fn(&mut f32, &f32),
) {
    for (group, row) in to.iter().zip(rows.chunks_exact(columns)) {
        let of_group = &mut of_groups[*group as usize * columns..][..columns];
        of_group.iter_mut().zip(row).for_each(|(of_group, x)| each(of_group, x));
    }
}

/// The same, with numbers of rows that change.
#[inline(always)]
fn by_group_mut(
    to: &[u32],
    columns: usize,
    of_groups: &[f32],
    rows: &mut [f32],
    each: impl Fn(f32, &mut f32),
) {
    for (group, row) in to.iter().zip(rows.chunks_exact_mut(columns)) {
        let of_group = &of_groups[*group as usize * columns..][..columns];
        of_group.iter().zip(row).for_each(|(of_group, x)| each(*of_group, x));
    }
}

impl Tape {
    /// `p (d - sum of p d over the group)`
    pub(super) fn descend_softmax_groups(
        &mut self,
        x: Var,
        indices: Indices,
        groups: usize,
        own: Range<usize>,
    ) {
        let columns = self.columns(x);
        let mut scratch = mem::take(&mut self.scratch);
        let space = sized(&mut scratch, groups * columns + own.len());
        let (sums, d_x) = space.split_at_mut(groups * columns);
        let to = &self.indices[indices.0 as usize..indices.1 as usize];
        let y = &self.values[own.clone()];
        elementwise::multiply(y, &self.slopes[own], Store::Replace, d_x);
        sums.fill(0.0);
        by_group(to, columns, sums, d_x, |sum, product| *sum += product);
        for ((group, d_x), y) in
            to.iter().zip(d_x.chunks_exact_mut(columns)).zip(y.chunks_exact(columns))
        {
            let sums = &sums[*group as usize * columns..][..columns];
            d_x.iter_mut().zip(y.iter().zip(sums)).for_each(|(d_x, (y, sum))| *d_x -= y * sum);
        }
        self.keep(x, d_x);
        self.scratch = scratch;
    }

    /// Through queries, keys and values. Their slopes are written where they belong if nothing stands there yet.
    pub(super) fn descend_split_attention(
        &mut self,
        inputs: [Var; 2],
        [lists, weights, shares]: [usize; 3],
        own: Range<usize>,
    ) {
        let ranges = inputs.map(|var| self.of(var).range());
        let stores = inputs.map(|var| self.slopes_of(var).map(|(_, store)| store));
        let at_place = stores == [Some(Store::Replace); 2];
        let lists = &self.lists.things[lists];
        let [pairs, queries] = [lists.pairs(), lists.queries()].map(|rows| rows * HEADS);
        let lengths = ranges.clone().map(|range| if at_place { 0 } else { range.len() });
        let mut scratch = mem::take(&mut self.scratch);
        let space = sized(&mut scratch, pairs + lengths[0] + lengths[1]);
        let (d_scores, space) = space.split_at_mut(pairs);
        let (before, rest) = self.slopes.split_at_mut(own.start);
        let [d_queries, d_keys_values] = if at_place {
            before.get_disjoint_mut(ranges.clone()).expect("queries are no keys")
        } else {
            space.split_at_mut(lengths[0]).into()
        };
        let pass = split_attention::Backward {
            queries: &self.values[ranges[0].clone()],
            keys_values: &self.values[ranges[1].clone()],
            weights: &self.values[weights..][..pairs],
            shares: &self.values[shares..][..queries],
            output: &self.values[own.clone()],
            d_output: &rest[..own.len()],
            d_scores,
            d_queries,
            d_keys_values,
        };
        split_attention::backward(self.nodes[inputs[0].0 as usize].columns as usize, lists, pass);
        if !at_place {
            let slopes = space.split_at(lengths[0]);
            for ((range, store), slopes) in ranges.into_iter().zip(stores).zip([slopes.0, slopes.1])
            {
                if let Some(store) = store {
                    elementwise::scale(1.0, slopes, store, &mut self.slopes[range]);
                }
            }
        }
        self.scratch = scratch;
    }
}
