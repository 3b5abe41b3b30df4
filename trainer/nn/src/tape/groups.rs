//! Steps by groups of rows, such as the agents of each team, and by what is seen in two parts.

use std::mem;
use std::ops::Range;

use super::backward::sized;
use super::{Indices, Operation, Pass, Tape, Var};
use crate::layers::matrix::Store;
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

    /// `share a + (1 - share) b`, with a share `[rows, groups]` for each of several equal groups of columns, such as heads.
    pub fn blend(&mut self, share: Var, a: Var, b: Var) -> Var {
        let size = self.size(a);
        let [rows, groups] = self.size(share);
        assert_eq!((size, rows, size[1] % groups), (self.size(b), size[0], 0), "sizes");
        let width = size[1] / groups;
        let ranges = [share, a, b].map(|var| self.tape.of(var).range());
        let needs = [share, a, b].iter().any(|var| self.tape.needs(*var));
        let y = self.tape.push(Operation::Blend { share, a, b }, rows, size[1], needs);
        let (before, out) = self.tape.split(y);
        let [share, a, b] = ranges.map(|range| &before[range]);
        let parts = a.chunks_exact(width).zip(b.chunks_exact(width));
        for ((out, (a, b)), share) in out.chunks_exact_mut(width).zip(parts).zip(share) {
            out.iter_mut().zip(a.iter().zip(b)).for_each(|(y, (a, b))| *y = b + share * (a - b));
        }
        y
    }

    /// What each query makes of two lists of rows together, and of each of them alone, as imagined passes need it (REFIL,
    /// dissertation section 5.4): no pair is looked at twice. Sizes as of [`attention`](Self::attention).
    pub fn attention_in_parts(
        &mut self,
        queries: Var,
        keys_values: Var,
        parts: [&VisibleLists; 2],
        heads: usize,
    ) -> [Var; 3] {
        let [(first, mass), (second, other)] = parts.map(|part| {
            let [attended, mass] = self.attention_with_masses(queries, keys_values, part, heads);
            (attended, mass)
        });
        let other = self.scale(other, -1.0);
        let larger = self.add(mass, other);
        let share = self.sigmoid(larger);
        [self.blend(share, first, second), first, second]
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

    pub(super) fn descend_blend(&mut self, [share, a, b]: [Var; 3], own: Range<usize>) {
        let width = self.columns(a) / self.columns(share);
        let [shares, firsts, seconds] = [share, a, b].map(|var| self.of(var).range());
        for (part, is_first) in [(a, true), (b, false)] {
            let shares = shares.clone();
            self.from(part, own.clone(), |store, values, _, d_y, d_x| {
                let slopes = d_x.chunks_exact_mut(width).zip(d_y.chunks_exact(width));
                for ((d_x, d_y), share) in slopes.zip(&values[shares]) {
                    let share = if is_first { *share } else { 1.0 - share };
                    let pairs = d_x.iter_mut().zip(d_y);
                    match store {
                        Store::Replace => pairs.for_each(|(d_x, d_y)| *d_x = share * d_y),
                        Store::Add => pairs.for_each(|(d_x, d_y)| *d_x += share * d_y),
                    }
                }
            });
        }
        self.from(share, own, |store, values, _, d_y, d_share| {
            let parts = values[firsts].chunks_exact(width).zip(values[seconds].chunks_exact(width));
            let rows = parts.zip(d_y.chunks_exact(width));
            for (d_share, ((a, b), d_y)) in d_share.iter_mut().zip(rows) {
                let terms = a.iter().zip(b).zip(d_y);
                let slope: f32 = terms.map(|((a, b), d_y)| d_y * (a - b)).sum();
                *d_share = if store == Store::Add { *d_share + slope } else { slope };
            }
        });
    }
}
