//! The way back through attention.

use std::mem;
use std::ops::Range;

use super::backward::sized;
use super::{Tape, Var};
use crate::layers::attention::{self, AttentionShape};
use crate::layers::attention_scores;

impl Tape {
    /// Through queries, keys and values.
    pub(super) fn descend_attention(
        &mut self,
        [queries, keys_values]: [Var; 2],
        lists: u32,
        weights: usize,
        shape: AttentionShape,
        own: Range<usize>,
    ) {
        let visible = &self.lists.things[lists as usize];
        let ranges = [queries, keys_values].map(|var| self.of(var).range());
        let [q, kv] = ranges.clone().map(|range| &self.values[range]);
        let longest = (0..visible.queries()).map(|query| visible.span(query).1.len()).max();
        let numbers = [q.len(), kv.len(), longest.unwrap_or(0) * shape.heads];
        let mut scratch = mem::take(&mut self.scratch);
        let space = sized(&mut scratch, numbers.iter().sum());
        let (d_queries, space) = space.split_at_mut(numbers[0]);
        let (d_keys_values, d_scores) = space.split_at_mut(numbers[1]);
        let pass = attention::Backward {
            queries: q,
            keys_values: kv,
            weights: &self.values[weights..][..visible.pairs() * shape.heads],
            d_output: &self.slopes[own],
            d_scores,
            d_queries: &mut *d_queries,
            d_keys_values: &mut *d_keys_values,
        };
        attention::backward(shape, visible, pass);
        self.keep(keys_values, d_keys_values);
        self.keep(queries, d_queries);
        self.scratch = scratch;
    }

    /// Through the squared scores of queries and keys.
    pub(super) fn descend_scores(
        &mut self,
        [queries, keys_values]: [Var; 2],
        lists: u32,
        shape: AttentionShape,
        own: Range<usize>,
    ) {
        let ranges = [queries, keys_values].map(|var| self.of(var).range());
        let [q, kv] = ranges.map(|range| &self.values[range]);
        let mut scratch = mem::take(&mut self.scratch);
        let space = sized(&mut scratch, q.len() + kv.len());
        space.fill(0.0);
        let (d_queries, d_keys_values) = space.split_at_mut(q.len());
        let pass = attention_scores::Backward {
            queries: q,
            keys_values: kv,
            d_sums: &self.slopes[own],
            d_queries: &mut *d_queries,
            d_keys_values: &mut *d_keys_values,
        };
        attention_scores::backward(shape, &self.lists.things[lists as usize], pass);
        self.keep(keys_values, d_keys_values);
        self.keep(queries, d_queries);
        self.scratch = scratch;
    }
}
