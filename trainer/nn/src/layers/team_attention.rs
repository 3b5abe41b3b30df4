//! Attention of teams: all queries of a team attend to the same rows, and sums of rows stand in for values.
//!
//! Where what follows the attention is linear, the value matrix can be a part of it (networks without an
//! activation behind the attention): each head then hands on the weighted sum of the rows themselves.
//! Where furthermore only the sum over a team's queries is asked for, weights are added up before rows
//! are. Both are exact.

use super::attention::{
    AttentionShape, AttentionWork, VisibleLists, run_sized, softmax_columns,
    softmax_columns_backward,
};
use super::vectors::{add_scaled, add_weighted_sum, dots, dots_with, weighted_sum};

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

/// The tensors of a forward pass.
#[derive(Debug)]
pub struct Forward<'a> {
    /// `[queries, width]`
    pub queries: &'a [f32],
    /// `[rows, width]`
    pub keys: &'a [f32],
    /// What is summed, `[rows, width]`.
    pub rows: &'a [f32],
    /// Attention weights `[pairs, heads]`, written.
    pub weights: &'a mut [f32],
    /// `[sums, heads, width]`, written.
    pub sums: &'a mut [f32],
}

/// Writes attention weights and weighted sums of rows.
pub fn forward(shape: AttentionShape, teams: &TeamLists, sums: Sums, pass: Forward<'_>) {
    run_sized::<32, 64, 64>(ForwardWork { shape, teams, sums, pass });
}

struct ForwardWork<'a> {
    shape: AttentionShape,
    teams: &'a TeamLists,
    sums: Sums,
    pass: Forward<'a>,
}

impl AttentionWork for ForwardWork<'_> {
    fn shape(&self) -> AttentionShape {
        self.shape
    }

    #[inline(always)]
    fn pass<const LANES: usize>(self, shape: AttentionShape) {
        let Self { teams, sums, pass, .. } = self;
        let (mut weights, mut out) = (pass.weights, pass.sums);
        let mut totals = Vec::new();
        for (queries, rows) in teams.each() {
            let count = rows.len() * shape.heads;
            let own = weights.split_off_mut(..queries.len() * count).expect("as many as pairs");
            for (query, weights) in queries.clone().zip(own.chunks_exact_mut(count.max(1))) {
                let query = &pass.queries[query * shape.width..][..shape.width];
                weigh(shape, query, pass.keys, rows, weights);
            }
            let wide = shape.heads * shape.width;
            match sums {
                Sums::PerQuery => {
                    let out = out.split_off_mut(..queries.len() * wide).expect("one per query");
                    for (index, out) in out.chunks_exact_mut(wide).enumerate() {
                        sum_rows::<LANES>(
                            shape,
                            &own[index * count..][..count],
                            pass.rows,
                            rows,
                            out,
                        );
                    }
                }
                Sums::PerTeam => {
                    add_up(own, count, &mut totals);
                    let out = out.split_off_mut(..wide).expect("one per team");
                    sum_rows::<LANES>(shape, &totals, pass.rows, rows, out);
                }
            }
        }
    }
}

/// Writes the attention weights `[list, heads]` of one query.
#[inline(always)]
fn weigh(shape: AttentionShape, query: &[f32], keys: &[f32], list: &[u32], weights: &mut [f32]) {
    let AttentionShape { width, heads } = shape;
    let scale = shape.scale();
    for (row, scores) in list.iter().zip(weights.chunks_exact_mut(heads)) {
        dots(query, &keys[*row as usize * width..][..width], scores);
        scores.iter_mut().for_each(|score| *score *= scale);
    }
    softmax_columns(weights, heads);
}

/// Writes for each head the sum of the listed rows, weighted by `weights [list, heads]`.
#[inline(always)]
fn sum_rows<const LANES: usize>(
    shape: AttentionShape,
    weights: &[f32],
    rows: &[f32],
    list: &[u32],
    out: &mut [f32],
) {
    let AttentionShape { width, heads } = shape;
    for (head, out) in out.chunks_exact_mut(width).enumerate() {
        let terms = list
            .iter()
            .zip(weights.chunks_exact(heads))
            .map(|(row, weights)| (weights[head], &rows[*row as usize * width..][..width]));
        weighted_sum::<LANES>(None, terms, out);
    }
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

/// The tensors of a backward pass.
#[derive(Debug)]
pub struct Backward<'a> {
    /// `[queries, width]`, as in the forward pass.
    pub queries: &'a [f32],
    /// `[rows, width]`, as in the forward pass.
    pub keys: &'a [f32],
    /// `[rows, width]`, as in the forward pass.
    pub rows: &'a [f32],
    /// Attention weights `[pairs, heads]` that the forward pass wrote.
    pub weights: &'a [f32],
    /// Gradient of the sums `[sums, heads, width]`.
    pub d_sums: &'a [f32],
    /// Gradient of the queries `[queries, width]`, overwritten.
    pub d_queries: &'a mut [f32],
    /// Gradient of the keys `[rows, width]`, overwritten.
    pub d_keys: &'a mut [f32],
    /// Gradient of the rows as they are summed `[rows, width]`, overwritten.
    pub d_rows: &'a mut [f32],
}

/// Writes the gradients of queries, keys and rows.
pub fn backward(shape: AttentionShape, teams: &TeamLists, sums: Sums, pass: Backward<'_>) {
    run_sized::<32, 64, 64>(BackwardWork { shape, teams, sums, pass });
}

struct BackwardWork<'a> {
    shape: AttentionShape,
    teams: &'a TeamLists,
    sums: Sums,
    pass: Backward<'a>,
}

impl AttentionWork for BackwardWork<'_> {
    fn shape(&self) -> AttentionShape {
        self.shape
    }

    #[inline(always)]
    fn pass<const LANES: usize>(self, shape: AttentionShape) {
        let Self { teams, sums, mut pass, .. } = self;
        pass.d_keys.fill(0.0);
        pass.d_rows.fill(0.0);
        let wide = shape.heads * shape.width;
        let (mut weights, mut d_sums) = (pass.weights, pass.d_sums);
        let (mut totals, mut d_totals, mut d_scores) = (Vec::new(), Vec::new(), Vec::new());
        for (queries, list) in teams.each() {
            let count = list.len() * shape.heads;
            let own = weights.split_off(..queries.len() * count).expect("as many as pairs");
            if sums == Sums::PerTeam {
                let d_sums = d_sums.split_off(..wide).expect("one per team");
                add_up(own, count, &mut totals);
                d_totals.resize(count, 0.0);
                descend_sum::<LANES>(shape, &totals, list, d_sums, &mut pass, &mut d_totals);
            }
            for (query, weights) in queries.zip(own.chunks_exact(count.max(1))) {
                if sums == Sums::PerTeam {
                    d_scores.clone_from(&d_totals);
                } else {
                    let d_sums = d_sums.split_off(..wide).expect("one per query");
                    d_scores.resize(count, 0.0);
                    descend_sum::<LANES>(shape, weights, list, d_sums, &mut pass, &mut d_scores);
                }
                softmax_columns_backward(weights, &mut d_scores, shape.heads);
                descend_scores(shape, query, list, &mut d_scores, &mut pass);
            }
        }
    }
}

/// Goes back through [`sum_rows`]: adds to the rows' gradients, writes that of the weights.
#[inline(always)]
fn descend_sum<const LANES: usize>(
    shape: AttentionShape,
    weights: &[f32],
    list: &[u32],
    d_sums: &[f32],
    pass: &mut Backward<'_>,
    d_weights: &mut [f32],
) {
    let AttentionShape { width, heads } = shape;
    let weights = weights.chunks_exact(heads).zip(d_weights.chunks_exact_mut(heads));
    for (row, (weights, d_weights)) in list.iter().zip(weights) {
        let at = *row as usize * width;
        dots_with(d_sums, &pass.rows[at..][..width], d_weights);
        let terms = weights.iter().copied().zip(d_sums.chunks_exact(width));
        add_weighted_sum::<LANES>(&mut pass.d_rows[at..][..width], terms);
    }
}

/// Goes back from the gradient of one query's scores, before their scale, to query and keys.
#[inline(always)]
fn descend_scores(
    shape: AttentionShape,
    query: usize,
    list: &[u32],
    d_scores: &mut [f32],
    pass: &mut Backward<'_>,
) {
    let AttentionShape { width, heads } = shape;
    let (head, scale) = (width / heads, shape.scale());
    d_scores.iter_mut().for_each(|d_score| *d_score *= scale);
    let d_query = &mut pass.d_queries[query * width..][..width];
    for (h, d_query) in d_query.chunks_exact_mut(head).enumerate() {
        let keys = list.iter().zip(d_scores.chunks_exact(heads)).map(|(row, d_scores)| {
            (d_scores[h], &pass.keys[*row as usize * width + h * head..][..head])
        });
        weighted_sum::<16>(None, keys, d_query);
    }
    let query = &pass.queries[query * width..][..width];
    for (row, d_scores) in list.iter().zip(d_scores.chunks_exact(heads)) {
        let d_key = &mut pass.d_keys[*row as usize * width..][..width];
        for ((d_score, q), d_k) in
            d_scores.iter().zip(query.chunks_exact(head)).zip(d_key.chunks_exact_mut(head))
        {
            add_scaled(d_k, *d_score, q);
        }
    }
}

#[cfg(test)]
mod tests;
