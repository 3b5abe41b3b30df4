//! Steps by groups of rows, such as the agents of each team.

use std::mem;
use std::ops::Range;

use super::backward::sized;
use super::{Indices, Operation, Pass, Tape, Var};
use crate::layers::elementwise;
use crate::layers::matrix::Store;
use sortie_core::internal::math::exp;

impl Pass<'_> {
    /// So many rows, each the mean of all rows i of `x` for which `to[i]` is its number; zeros where there is none.
    pub fn mean_by(&mut self, x: Var, to: &[u32], rows: usize) -> Var {
        let sums = self.scatter(x, to, rows);
        let shares = self.tape.push(Operation::Given, rows, 1, false);
        let ([], counts) = self.tape.split([], shares);
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
        let operation = Operation::SoftmaxGroups { x, indices, groups };
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
        let columns = self.of(x).columns;
        let results = own.clone();
        self.descend_into([x], groups * columns, own, |tape, d_y, [d_x], sums| {
            let to = &tape.indices[indices.0..indices.1];
            let y = &tape.values[results];
            elementwise::multiply(y, d_y, Store::Replace, d_x);
            sums.fill(0.0);
            by_group(to, columns, sums, d_x, |sum, product| *sum += product);
            for ((group, d_x), y) in
                to.iter().zip(d_x.chunks_exact_mut(columns)).zip(y.chunks_exact(columns))
            {
                let sums = &sums[*group as usize * columns..][..columns];
                d_x.iter_mut().zip(y.iter().zip(sums)).for_each(|(d_x, (y, sum))| *d_x -= y * sum);
            }
        });
    }
}
