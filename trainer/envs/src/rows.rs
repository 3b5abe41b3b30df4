//! Rows of features without their zeros: what environments write and networks read.

use alloc::vec;
use alloc::vec::Vec;

/// Rows of features without their zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseRows {
    /// Row r owns the entries `ends[r] .. ends[r + 1]`; the first end is 0.
    ends: Vec<u32>,
    /// Columns and values.
    entries: Vec<(u16, f32)>,
}

impl Default for SparseRows {
    fn default() -> Self {
        Self { ends: vec![0], entries: Vec::new() }
    }
}

impl SparseRows {
    /// Forgets all rows, keeps the memory.
    pub fn clear(&mut self) {
        self.ends.truncate(1);
        self.entries.clear();
    }

    /// Adds one feature to the row that the next [`end_row`](Self::end_row) closes.
    #[inline]
    pub fn push(&mut self, column: usize, value: f32) {
        self.entries.push((column as u16, value));
    }

    /// Adds one feature, where it is no zero. It is written in any case and then kept or not: whether a flag is set is as good
    /// as random, so that a processor would guess wrong.
    #[inline]
    pub(crate) fn push_unless_zero(&mut self, column: usize, value: f32) {
        let before = self.entries.len();
        self.push(column, value);
        self.entries.truncate(before + usize::from(value != 0.0));
    }

    /// Adds features, columns and values, to the row that the next [`end_row`](Self::end_row) closes.
    #[inline]
    pub fn push_all(&mut self, features: &[(u16, f32)]) {
        self.entries.extend_from_slice(features);
    }

    /// Adds all features of a row of another collection to the row that the next
    /// [`end_row`](Self::end_row) closes.
    #[inline]
    pub fn push_row(&mut self, other: &Self, row: usize) {
        self.entries.extend_from_slice(other.entries_of(row));
    }

    /// Adds all features of a row of another collection, each so many columns further, to the row that the next
    /// [`end_row`](Self::end_row) closes.
    #[inline]
    pub fn push_row_at(&mut self, first: usize, other: &Self, row: usize) {
        other.row(row).for_each(|(column, value)| self.push(first + column, value));
    }

    /// Closes a row.
    #[inline]
    pub fn end_row(&mut self) {
        self.ends.push(self.entries.len() as u32);
    }

    /// Adds and closes a row given in full.
    pub fn push_dense(&mut self, row: &[f32]) {
        for (column, value) in row.iter().enumerate() {
            if *value != 0.0 {
                self.push(column, *value);
            }
        }
        self.end_row();
    }

    /// Adds all closed rows of another collection.
    pub fn append(&mut self, other: &Self) {
        let entries = self.entries.len() as u32;
        self.ends.extend(other.ends[1..].iter().map(|end| entries + end));
        self.entries.extend_from_slice(&other.entries);
    }

    /// Number of closed rows.
    pub fn len(&self) -> usize {
        self.ends.len() - 1
    }

    /// Number of non-zero features in all rows.
    pub fn entries(&self) -> usize {
        self.entries.len()
    }

    /// Whether no row has been closed.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Columns and values of the non-zero features of a row.
    #[inline(always)]
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, f32)> + Clone + '_ {
        self.entries_of(row).iter().map(|(column, value)| (usize::from(*column), *value))
    }

    /// Writes a row in full, zeros included.
    ///
    /// # Panics
    /// Where `dense` has fewer columns than the row.
    pub fn write_dense(&self, row: usize, dense: &mut [f32]) {
        dense.fill(0.0);
        self.row(row).for_each(|(column, value)| dense[column] = value);
    }

    /// Writes all closed rows in full, one behind the other.
    ///
    /// # Panics
    /// Where a row has more than so many columns.
    pub fn write_all(&self, columns: usize, dense: &mut Vec<f32>) {
        dense.resize(self.len() * columns, 0.0);
        for row in 0..self.len() {
            self.write_dense(row, &mut dense[row * columns..][..columns]);
        }
    }

    #[inline(always)]
    fn entries_of(&self, row: usize) -> &[(u16, f32)] {
        &self.entries[self.ends[row] as usize..self.ends[row + 1] as usize]
    }
}
