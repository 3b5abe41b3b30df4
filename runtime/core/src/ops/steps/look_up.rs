//! Rows of tables, each where a computed number says.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Flag, Place, Places, Scratch, Sizes, apart, slice};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// Which row a number means, and what becomes of one that means none, such as NaN or a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u32)]
#[non_exhaustive]
pub enum Choice {
    /// From the first on, or counted from the end where negative; others are refused, as ONNX refuses them in Gather.
    Any,
    /// From the first on, or counted from the end where negative; others take the last row, which no number means: a
    /// row of zeros without a one, as ONNX has it in `OneHot`.
    AnyOrLast,
    /// From the first on; others take the last row: as a number is compared with that of each row.
    FirstOrLast,
}

/// Copies rows `[columns]` of tables, as many of each table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LookUp {
    /// Which row an index means.
    pub choice: Choice,
    /// Whether the tables stand in the weights.
    pub constant: Flag,
    /// The tables `[rows, columns]`, one behind the other: floats of the weights or of the arena.
    pub tables: Place,
    /// Rows of a table.
    pub rows: u32,
    /// Numbers of a row.
    pub columns: u32,
    /// The indices, those of the first table first.
    pub indices: Place,
    /// A row for each, apart from all others.
    pub to: Place,
}

impl LookUp {
    /// Numbers of a table.
    fn table_len(&self) -> u64 {
        u64::from(self.rows) * u64::from(self.columns)
    }

    /// The row that an index means.
    #[inline(always)]
    fn row(&self, index: f32) -> Result<usize, DecideError> {
        let named = self.rows.saturating_sub(u32::from(self.choice != Choice::Any));
        let is_from_end = index < 0.0 && self.choice != Choice::FirstOrLast;
        let place = if is_from_end { index + named as f32 } else { index };
        // Saturates, and is 0 for NaN: neither is the number then.
        let row = place as u32;
        match self.choice {
            _ if row as f32 == place && row < named => Ok(row as usize),
            Choice::Any => Err(DecideError::NoSuchRow { rows: named as usize }),
            _ => Ok(named as usize),
        }
    }
}

impl Operator for LookUp {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        let tables = u64::from(self.tables.len).checked_div(self.table_len()).unwrap_or(0);
        let held = if self.constant.is_set() {
            sizes.holds_weights(self.tables.offset, self.tables.len.into())
        } else {
            sizes.hold_apart(&[&self.tables, &self.to])
        };
        held && tables > 0
            && tables * self.table_len() == u64::from(self.tables.len)
            && u64::from(self.indices.len).is_multiple_of(tables)
            && u64::from(self.to.len) == u64::from(self.indices.len) * u64::from(self.columns)
            && sizes.hold_apart(&[&self.indices, &self.to])
    }

    fn reads(&self) -> Places {
        if self.constant.is_set() {
            Places::of([self.indices])
        } else {
            Places::of([self.indices, self.tables])
        }
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (sources, to) = apart(scratch.floats, &self.to)?;
        let indices = sources.get(&self.indices)?;
        let tables = if self.constant.is_set() {
            slice(weights, self.tables.offset, self.tables.len as usize)?
        } else {
            sources.get(&self.tables)?
        };
        let columns = (self.columns as usize).max(1);
        let tables = tables.chunks_exact((self.rows as usize).saturating_mul(columns).max(1));
        let each = indices.len().checked_div(tables.len()).unwrap_or(0).max(1);
        // Chunks of nothing are a panic, and where lengths have 32 bits the product could wrap to zero.
        let each_to = each.saturating_mul(columns).max(1);
        let rows = indices.chunks_exact(each).zip(to.chunks_exact_mut(each_to));
        for (table, (indices, to)) in tables.zip(rows) {
            for (index, to) in indices.iter().zip(to.chunks_exact_mut(columns)) {
                let row = table.get(self.row(*index)? * columns..).ok_or(DecideError::BadLength)?;
                for (to, from) in to.iter_mut().zip(row) {
                    *to = *from;
                }
            }
        }
        Ok(())
    }
}
