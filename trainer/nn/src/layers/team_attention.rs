//! Attention of teams: all queries of a team attend to the same rows, and sums of rows stand in for values.
//!
//! Where what follows the attention is linear, the value matrix can be a part of it (networks without an
//! activation behind the attention): each head then hands on the weighted sum of the rows themselves.
//! Where furthermore only the sum over a team's queries is asked for, weights are added up before rows
//! are. Both are exact.

use super::attention::{AttentionShape, List, run_with_shape, softmax_columns_backward};
use super::lists::VisibleLists;
use super::vectors::add_scaled;

/// Teams of queries and the rows that each team attends to.
///
/// The queries of all teams, one team behind the other, are the first rows.
#[derive(Clone, Debug, PartialEq)]
pub struct TeamLists {
    /// Team i owns the queries `ends[i] .. ends[i + 1]`; the first end is 0.
    ends: Vec<u32>,
    members: VisibleLists,
    pairs: usize,
}

impl Default for TeamLists {
    fn default() -> Self {
        Self { ends: vec![0], members: VisibleLists::default(), pairs: 0 }
    }
}

impl TeamLists {
    /// Forgets all teams, keeps the memory.
    #[inline]
    pub fn clear(&mut self) {
        self.ends.truncate(1);
        self.members.clear();
        self.pairs = 0;
    }

    /// Becomes a copy of others, keeps the memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.ends.clone_from(&other.ends);
        self.members.copy_from(&other.members);
        self.pairs = other.pairs;
    }

    /// Adds a row to those that the next team attends to.
    #[inline]
    pub fn push(&mut self, row: usize) {
        self.members.push(row);
    }

    /// Closes a team of so many queries.
    #[inline]
    pub fn end_team(&mut self, queries: usize) {
        self.members.end_list();
        self.ends.push((self.queries() + queries) as u32);
        self.pairs += queries * self.members.span(self.teams() - 1).1.len();
    }

    /// Number of teams.
    #[inline]
    pub fn teams(&self) -> usize {
        self.ends.len() - 1
    }

    /// Number of queries in all teams.
    #[inline]
    pub fn queries(&self) -> usize {
        self.ends[self.teams()] as usize
    }

    /// Number of queries of every team.
    #[inline]
    pub fn sizes(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        self.ends.windows(2).map(|ends| (ends[1] - ends[0]) as usize)
    }

    /// Pairs of a query and a row that it attends to.
    #[inline]
    pub fn pairs(&self) -> usize {
        self.pairs
    }

    /// Rows that teams attend to, counted once for each team.
    #[inline]
    pub fn members(&self) -> usize {
        self.members.pairs()
    }

    /// The queries and the rows of every team.
    #[inline(always)]
    fn each(&self) -> impl Iterator<Item = (std::ops::Range<usize>, &[u32])> {
        let spans = self.ends.windows(2).map(|ends| ends[0] as usize..ends[1] as usize);
        spans.enumerate().map(|(team, queries)| (queries, self.members.span(team).1))
    }
}

/// What there is a sum of rows for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sums {
    /// Every query.
    PerQuery,
    /// Every team: the sum over its queries.
    PerTeam,
}

impl Sums {
    /// How many sums there are.
    #[inline]
    pub fn count(self, teams: &TeamLists) -> usize {
        match self {
            Self::PerQuery => teams.queries(),
            Self::PerTeam => teams.teams(),
        }
    }
}

/// The tensors of a forward pass: queries `[queries, width]`, keys, and the rows that are summed, `[rows, width]` both.
#[derive(Debug)]
pub(crate) struct Forward<'a> {
    pub(crate) queries: &'a [f32],
    pub(crate) keys: &'a [f32],
    pub(crate) rows: &'a [f32],
    /// Attention weights `[pairs, heads]`, written.
    pub(crate) weights: &'a mut [f32],
    /// `[sums, heads, width]`, written.
    pub(crate) sums: &'a mut [f32],
}

/// Writes attention weights and weighted sums of rows.
pub(crate) fn forward(shape: AttentionShape, teams: &TeamLists, sums: Sums, pass: Forward<'_>) {
    let Forward { queries: all, keys, rows: matrix, mut weights, sums: mut out } = pass;
    let mut totals = Vec::new();
    run_with_shape(
        shape,
        #[inline(always)]
        |shape| {
            let AttentionShape { width, heads } = shape;
            for (queries, rows) in teams.each() {
                let list = List::whole(rows, shape);
                let (count, wide) = (rows.len() * heads, heads * width);
                let own = weights.split_off_mut(..queries.len() * count).expect("as many as pairs");
                for (query, weights) in queries.clone().zip(own.chunks_exact_mut(count.max(1))) {
                    list.weigh(keys, &all[query * width..][..width], shape.scale(), weights);
                }
                match sums {
                    Sums::PerQuery => {
                        let out = out.split_off_mut(..queries.len() * wide).expect("one per query");
                        for (index, out) in out.chunks_exact_mut(wide).enumerate() {
                            list.sum(matrix, &own[index * count..][..count], out);
                        }
                    }
                    Sums::PerTeam => {
                        add_up(own, count, &mut totals);
                        let out = out.split_off_mut(..wide).expect("one per team");
                        list.sum(matrix, &totals, out);
                    }
                }
            }
        },
    );
}

/// Adds up vectors of so many numbers that stand one behind the other.
#[inline(always)]
fn add_up(vectors: &[f32], numbers: usize, totals: &mut Vec<f32>) {
    totals.clear();
    totals.resize(numbers, 0.0);
    for vector in vectors.chunks_exact(numbers.max(1)) {
        add_scaled(totals, 1.0, vector);
    }
}

/// The tensors of a backward pass: those of the forward pass, the gradient of the sums, and those of the three inputs, which
/// are overwritten.
#[derive(Debug)]
pub(crate) struct Backward<'a> {
    pub(crate) queries: &'a [f32],
    pub(crate) keys: &'a [f32],
    pub(crate) rows: &'a [f32],
    pub(crate) weights: &'a [f32],
    pub(crate) d_sums: &'a [f32],
    pub(crate) d_queries: &'a mut [f32],
    pub(crate) d_keys: &'a mut [f32],
    pub(crate) d_rows: &'a mut [f32],
}

/// Writes the gradients of queries, keys and rows.
pub(crate) fn backward(shape: AttentionShape, teams: &TeamLists, sums: Sums, pass: Backward<'_>) {
    let Backward { queries: all, keys, rows: matrix, mut weights, mut d_sums, .. } = pass;
    let Backward { d_queries, d_keys, d_rows, .. } = pass;
    let (mut totals, mut d_totals, mut d_scores) = (Vec::new(), Vec::new(), Vec::new());
    run_with_shape(
        shape,
        #[inline(always)]
        |shape| {
            let AttentionShape { width, heads } = shape;
            d_keys.fill(0.0);
            d_rows.fill(0.0);
            for (queries, rows) in teams.each() {
                let list = List::whole(rows, shape);
                let (count, wide) = (rows.len() * heads, heads * width);
                let own = weights.split_off(..queries.len() * count).expect("as many as pairs");
                d_totals.resize(count, 0.0);
                d_scores.resize(count, 0.0);
                if sums == Sums::PerTeam {
                    let d_sums = d_sums.split_off(..wide).expect("one per team");
                    add_up(own, count, &mut totals);
                    list.products(matrix, d_sums, &mut d_totals);
                    list.add_multiples(d_rows, &totals, d_sums);
                }
                for (query, weights) in queries.zip(own.chunks_exact(count.max(1))) {
                    if sums == Sums::PerTeam {
                        d_scores.copy_from_slice(&d_totals);
                    } else {
                        let d_sums = d_sums.split_off(..wide).expect("one per query");
                        list.products(matrix, d_sums, &mut d_scores);
                        list.add_multiples(d_rows, weights, d_sums);
                    }
                    softmax_columns_backward(weights, &mut d_scores, heads);
                    d_scores.iter_mut().for_each(|d_score| *d_score *= shape.scale());
                    let own = query * width..(query + 1) * width;
                    list.sum(keys, &d_scores, &mut d_queries[own.clone()]);
                    list.add_multiples(d_keys, &d_scores, &all[own]);
                }
            }
        },
    );
}

#[cfg(test)]
mod tests;
