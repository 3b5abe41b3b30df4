//! Who sees what, split by a partition.

use std::ops::Range;

/// For each query the rows that it sees: those within its part of a partition, then those across.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SplitLists {
    /// Query i sees `rows[ends[i] .. ends[i + 1]]`; the first end is 0.
    ends: Vec<u32>,
    /// Where in `rows` the rows across begin, per query.
    splits: Vec<u32>,
    rows: Vec<u32>,
}

impl Default for SplitLists {
    fn default() -> Self {
        Self { ends: vec![0], splits: Vec::new(), rows: Vec::new() }
    }
}

impl SplitLists {
    /// Forgets all lists, keeps the memory.
    pub(super) fn clear(&mut self) {
        self.ends.truncate(1);
        self.splits.clear();
        self.rows.clear();
    }

    /// Adds the list of one query: rows within its part, and across. Without a partition all are within.
    pub(super) fn push(
        &mut self,
        within: impl Iterator<Item = usize>,
        across: impl Iterator<Item = usize>,
    ) {
        self.rows.extend(within.map(|row| row as u32));
        self.splits.push(self.rows.len() as u32);
        self.rows.extend(across.map(|row| row as u32));
        self.ends.push(self.rows.len() as u32);
    }

    /// Number of queries.
    pub(super) fn queries(&self) -> usize {
        self.splits.len()
    }

    /// The rows of all lists.
    #[inline(always)]
    pub(super) fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Total length of all lists.
    pub(super) fn pairs(&self) -> usize {
        self.rows.len()
    }

    /// The pairs of every query, and how many of them lie within.
    #[inline(always)]
    pub(super) fn spans(&self) -> impl Iterator<Item = (Range<usize>, usize)> {
        let ends = self.ends.windows(2).map(|ends| ends[0] as usize..ends[1] as usize);
        ends.zip(&self.splits).map(|(pairs, split)| {
            let within = *split as usize - pairs.start;
            (pairs, within)
        })
    }
}
