//! Who sees what: for each query the rows of a matrix that it attends to, of any number.

/// For each query the rows that it sees. A partition may split them into those within a part of it, which come first, and
/// those across; without one all are within.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleLists {
    /// Query i sees `rows[ends[i] .. ends[i + 1]]`; the first end is 0.
    ends: Vec<u32>,
    /// Where in `rows` the rows across begin, per query.
    splits: Vec<u32>,
    rows: Vec<u32>,
}

impl Default for VisibleLists {
    fn default() -> Self {
        Self { ends: vec![0], splits: Vec::new(), rows: Vec::new() }
    }
}

impl VisibleLists {
    /// Forgets all lists, keeps the memory.
    #[inline]
    pub fn clear(&mut self) {
        self.ends.truncate(1);
        self.splits.clear();
        self.rows.clear();
    }

    /// Becomes a copy of others, keeps the memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.ends.clone_from(&other.ends);
        self.splits.clone_from(&other.splits);
        self.rows.clone_from(&other.rows);
    }

    /// Adds a row to the list that the next [`end_list`](Self::end_list) closes.
    #[inline]
    pub fn push(&mut self, row: usize) {
        self.rows.push(row as u32);
    }

    /// Closes the list of one query.
    #[inline]
    pub fn end_list(&mut self) {
        self.splits.push(self.rows.len() as u32);
        self.ends.push(self.rows.len() as u32);
    }

    /// Adds the list of one query: rows within its part, and across.
    pub fn push_parts(
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
    #[inline]
    pub fn queries(&self) -> usize {
        self.splits.len()
    }

    /// Total length of all lists.
    #[inline]
    pub fn pairs(&self) -> usize {
        self.rows.len()
    }

    /// The rows that a query sees.
    #[inline]
    pub fn list(&self, query: usize) -> impl Iterator<Item = usize> + '_ {
        self.span(query).1.iter().map(|row| *row as usize)
    }

    /// Where a query's pairs begin, and its rows.
    #[inline]
    pub(crate) fn span(&self, query: usize) -> (usize, &[u32]) {
        let (start, end) = (self.ends[query] as usize, self.ends[query + 1] as usize);
        (start, &self.rows[start..end])
    }

    /// Of every query where its pairs begin, the rows that it sees, and how many of them lie within its part.
    #[inline(always)]
    pub(super) fn each(&self) -> impl Iterator<Item = (usize, &[u32], usize)> {
        (0..self.queries()).map(|query| {
            let (start, rows) = self.span(query);
            (start, rows, self.splits[query] as usize - start)
        })
    }
}
