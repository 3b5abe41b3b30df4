//! Multi-head attention of one query: the agent's own.

use core::ops::Range;

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::operator::Operator;
use super::team::{Member, Team};
use super::{Flag, LAYOUT_TILES, Linear, Place, Scratch, Sizes, places, slice};
use crate::kernels::product::{Around, Sparse, TILE, padded};
use crate::kernels::rows::Rows;
use crate::kernels::softmax::slots;
use crate::kernels::{HEADS, Head, Heads, Kernels};
use crate::policy::{DecideError, Observation};

/// Attention over the embedded rows, rewritten for a single query (dissertation section 2.3).
///
/// With q = W_q x_own / √h, the keys are absorbed: u_j = W_k,jᵀ q_j once per head j, then a score is u_j · x_e.
/// The values are postponed: z_j = Σ a_e x_e, then o_j = W_v,j z_j. Both are exact rewrites that need one
/// matrix product where the plain form needs one per entity. A row that sees nothing has o = 0.
///
/// Where the output layer has E inputs more, they are the own row itself, however little the agent sees: a *skip*
/// past the attention, W_o o + W_s x_own as one product.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct AttendOwn {
    /// The embeddings that [`super::EmbedEntities`] wrote.
    pub rows: Place,
    /// Width E of an embedding.
    pub width: u16,
    /// Heads.
    pub heads: u16,
    /// W_q, divided by the root of the head width h: E inputs, heads · h outputs.
    pub query: Linear,
    /// W_k: for every head a matrix of h inputs and E outputs.
    pub keys: u32,
    /// W_v: for every head a matrix of E inputs and h outputs.
    pub values: u32,
    /// W_o; its inputs are the heads' outputs, each padded like outputs are. With a skip W_s stands below it.
    pub output: Linear,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// q, padded.
    pub query_place: Place,
    /// u of one head, padded E floats.
    pub absorbed: Place,
    /// Scores of one head, `[n_max]`.
    pub scores: Place,
    /// z of one head, padded E floats.
    pub mixed: Place,
    /// o of all heads, as many floats as the output layer has inputs.
    pub attended: Place,
    /// The result, padded.
    pub to: Place,
}

impl Operator for AttendOwn {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let (heads, head_width) = (usize::from(self.heads), self.head_width());
        let rows = (u64::from(sizes.n_max) + 1).saturating_mul(self.padded_width() as u64);
        let all = |len: usize| heads as u64 * len as u64;
        let layers = self.query.check(sizes)
            && self.output.check(sizes)
            && sizes.holds_weights(self.keys, all(self.keys_len()))
            && sizes.holds_weights(self.values, all(self.values_len()));
        let widths = head_width > 0
            && head_width * heads == usize::from(self.query.outputs)
            && self.query.inputs == self.width
            && self.has_inputs(usize::from(self.output.inputs))
            && sizes.lists(u64::from(self.width));
        let lengths = u64::from(self.rows.len) == rows
            && self.query_place.len as usize == self.query.padded_outputs()
            && self.absorbed.len as usize == self.padded_width()
            && self.scores.len == sizes.n_max
            && self.mixed.len as usize == self.padded_width()
            && self.attended.len == u32::from(self.output.inputs)
            && self.to.len as usize == self.output.padded_outputs();
        layers && widths && lengths && sizes.hold_apart(&self.places().each_ref())
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        let heads = u64::from(self.heads);
        let per_entity = 2 * heads * self.padded_width() as u64;
        let matrices = heads * (self.keys_len() as u64 + self.values_len() as u64);
        let layers = self.query.multiply_adds() + self.output.multiply_adds();
        layers + matrices + visible * per_entity
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let visible = scratch.visible;
        if visible > 1 {
            self.ask(kernels, weights, scratch)?;
        }
        let [rows, query, absorbed, scores, mixed, attended, to] =
            places(scratch.floats, self.places().each_ref())?;
        if visible == 0 {
            attended.fill(0.0);
        } else if visible > 1 && visible <= K::ATTENDED && self.has_heads_together() {
            let rows = Rows::first(rows, self.padded_width(), visible);
            self.heads_together(kernels, weights, rows, query, attended)?;
        } else {
            let rows = Rows::first(rows, self.padded_width(), visible);
            self.heads_one_by_one(
                kernels,
                weights,
                rows,
                [query, absorbed, scores, mixed, attended],
            )?;
        }
        if self.skips() {
            let start = scratch.own.saturating_mul(self.padded_width());
            let own = rows.get(start..).ok_or(DecideError::BadLength)?;
            let kept = attended.get_mut(self.joined()..).ok_or(DecideError::BadLength)?;
            for (to, from) in kept.iter_mut().zip(own) {
                *to = *from;
            }
        }
        let around = self.output.around(weights, self.relu.is_set())?;
        kernels.product(self.output.matrix(weights)?, attended, around, to);
        Ok(())
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        // Its places do not overlap, and the first are the shared rows.
        self.rows == Place { offset: 0, len: shared }
    }

    /// As [`Self::run`] for all members of a team.
    fn run_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        _: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        if team.shared.len() >= self.shared_floats() && team.is_one_entity() {
            return self.run_shared(kernels, weights, team);
        }
        let asks = |member: &Member| member.slots.len() > 1;
        let sees = |member: &Member| !member.slots.is_empty();
        let (width, absorbed) = (usize::from(self.width), &self.absorbed);
        let step = padded(self.head_width());
        let (matrix, around) = (self.query.matrix(weights)?, self.query.around(weights, false)?);
        let mut pairs = team.own_rows(width, &self.query_place, asks);
        // Rows come out of a ReLU; few outputs wait for their additions where each member has its own.
        if self.query.padded_outputs() >= 2 * TILE {
            kernels.sparse_products(matrix, &mut pairs, around);
        } else {
            kernels.products(matrix, &mut pairs, around);
        }
        drop(pairs);
        for head in 0..usize::from(self.heads) {
            let query = self.query_place.part(self.head(head));
            let matrix = self.keys(weights, head)?;
            kernels.products(matrix, &mut team.pairs(&query, absorbed, asks), Around::NOTHING);
            self.attend_team(kernels, team)?;
            let mixed = self.mixed.part(0..width);
            let output = self.attended.part(head * step..(head + 1) * step);
            let matrix = self.values(weights, head)?;
            kernels.products(matrix, &mut team.pairs(&mixed, &output, sees), Around::NOTHING);
        }
        self.answer_team(kernels, weights, team)
    }
}

impl AttendOwn {
    pub(super) fn head_width(&self) -> usize {
        usize::from(self.query.outputs).checked_div(usize::from(self.heads)).unwrap_or(0)
    }

    pub(super) fn padded_width(&self) -> usize {
        padded(usize::from(self.width))
    }

    /// Floats of all heads' outputs.
    fn joined(&self) -> usize {
        usize::from(self.heads).saturating_mul(padded(self.head_width()))
    }

    /// Whether the output layer may have so many inputs: those of the heads, and with a skip the own row's.
    fn has_inputs(&self, inputs: usize) -> bool {
        inputs.checked_sub(self.joined()).is_some_and(|rest| [0, self.width.into()].contains(&rest))
    }

    /// Whether the output layer takes the own row as well.
    pub fn skips(&self) -> bool {
        usize::from(self.output.inputs) > self.joined()
    }

    fn keys_len(&self) -> usize {
        self.head_width() * self.padded_width()
    }

    fn values_len(&self) -> usize {
        usize::from(self.width) * padded(self.head_width())
    }

    pub(super) fn places(&self) -> [Place; 7] {
        // Scores are worked on in whole vectors, for which a plan leaves room behind the last one.
        let scores = Place { len: slots(self.scores.len as usize) as u32, ..self.scores };
        let Self { rows, query_place, absorbed, mixed, attended, to, .. } = *self;
        [rows, query_place, absorbed, scores, mixed, attended, to]
    }

    /// Computes o of all heads.
    #[inline(always)]
    fn heads_one_by_one(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        rows: Rows<'_>,
        [query, absorbed, scores, mixed, attended]: [&mut [f32]; 5],
    ) -> Result<(), DecideError> {
        let (visible, heads) = (rows.slots.len(), usize::from(self.heads));
        let outputs = attended.chunks_exact_mut(padded(self.head_width()));
        for (head, output) in (0..heads).zip(outputs) {
            if head == 0 && visible > 1 {
                self.absorb(kernels, weights, head, query, absorbed)?;
            }
            let scores = weigh(kernels, rows, absorbed, scores)?;
            // Before the weights are used: while they are waited for, matrices of the next head are read.
            if head + 1 < heads && visible > 1 {
                self.absorb(kernels, weights, head + 1, query, absorbed)?;
            }
            kernels.mix(scores, rows, mixed);
            self.look_up(kernels, weights, head, mixed, output)?;
        }
        Ok(())
    }

    /// Whether heads and widths are such that [`Kernels::attend`] takes them.
    fn has_heads_together(&self) -> bool {
        usize::from(self.heads).is_multiple_of(HEADS)
            && [TILE, 2 * TILE].contains(&self.padded_width())
    }

    /// As [`Self::heads_one_by_one`] for several at once, with their vectors on the stack: a plan has room for one.
    #[inline(always)]
    fn heads_together(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        rows: Rows<'_>,
        query: &[f32],
        attended: &mut [f32],
    ) -> Result<(), DecideError> {
        let mut outputs = attended.chunks_exact_mut(padded(self.head_width()));
        for first in (0..usize::from(self.heads)).step_by(HEADS) {
            let mut vectors: [Head; HEADS] = [[0.0; _]; HEADS];
            for (head, absorbed) in (first..).zip(&mut vectors) {
                let absorbed = absorbed.get_mut(..rows.width).ok_or(DecideError::BadLength)?;
                self.absorb(kernels, weights, head, query, absorbed)?;
            }
            let soon = self.values as usize + first * self.values_len();
            let soon = weights.get(soon..).ok_or(DecideError::BadLength)?;
            let heads = vectors.each_mut().map(|v| v.get_mut(..rows.width).unwrap_or(&mut []));
            if !kernels.attend(&mut [Heads { heads, keys: rows, values: rows }], soon) {
                return Err(DecideError::NonFinite);
            }
            for ((head, mixed), output) in (first..).zip(&vectors).zip(&mut outputs) {
                self.look_up(kernels, weights, head, mixed, output)?;
            }
        }
        Ok(())
    }

    /// Computes o of one head.
    #[inline(always)]
    fn look_up(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        head: usize,
        mixed: &[f32],
        output: &mut [f32],
    ) -> Result<(), DecideError> {
        let mixed = mixed.get(..usize::from(self.width)).ok_or(DecideError::BadLength)?;
        kernels.product(self.values(weights, head)?, mixed, Around::NOTHING, output);
        Ok(())
    }

    /// Computes u of one head.
    #[inline(always)]
    fn absorb(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        head: usize,
        query: &[f32],
        absorbed: &mut [f32],
    ) -> Result<(), DecideError> {
        let query = query.get(self.head(head)).ok_or(DecideError::BadLength)?;
        kernels.product(self.keys(weights, head)?, query, Around::NOTHING, absorbed);
        Ok(())
    }

    /// The output layer for every member.
    pub(super) fn answer_team(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        if self.skips() {
            let kept = self.attended.part(self.joined()..self.attended.len as usize);
            team.keep_own_rows(usize::from(self.width), &kept);
        }
        let (matrix, around) =
            (self.output.matrix(weights)?, self.output.around(weights, self.relu.is_set())?);
        kernels.products(matrix, &mut team.pairs(&self.attended, &self.to, |_| true), around);
        Ok(())
    }

    /// Mixes rows by one head's scores for every member; who sees nothing gets zeros.
    fn attend_team(&self, kernels: impl Kernels, team: &mut Team<'_>) -> Result<(), DecideError> {
        let [_, _, absorbed, scores, mixed, attended, _] = self.places();
        let wanted = [absorbed, scores, mixed, attended].map(|place| team.own_place(&place));
        let Team { rows, own, own_floats, members, .. } = team;
        for (member, floats) in members.iter_mut().zip(own.chunks_exact_mut((*own_floats).max(1))) {
            let [absorbed, scores, mixed, attended] = places(floats, wanted.each_ref())?;
            if member.slots.is_empty() {
                attended.fill(0.0);
                continue;
            }
            let rows = Rows { slots: &member.slots, ..Rows::first(rows, self.padded_width(), 0) };
            member.alone |= attend(kernels, rows, absorbed, scores, mixed).is_err();
        }
        Ok(())
    }

    /// Computes q of the agent's own row, which comes out of a ReLU.
    #[inline(always)]
    fn ask(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let [rows, query] = places(scratch.floats, [&self.rows, &self.query_place])?;
        let start = scratch.own * self.padded_width();
        let row = rows.get(start..start + usize::from(self.width));
        let values = row.ok_or(DecideError::BadLength)?;
        kernels.mark(values, scratch.nonzeros);
        let inputs = Sparse { values, marks: scratch.nonzeros, one: None, count: values.len() };
        let around = self.query.around(weights, false)?;
        let matrix = self.query.matrix(weights)?;
        kernels.sparse_product(matrix, inputs, around, query);
        Ok(())
    }

    /// The range of one head's part of q.
    pub(super) fn head(&self, head: usize) -> Range<usize> {
        let start = head * self.head_width();
        start..start + self.head_width()
    }

    pub(super) fn keys<'w>(
        &self,
        weights: &'w [f32],
        head: usize,
    ) -> Result<&'w [f32], DecideError> {
        let len = self.keys_len();
        slice(weights, self.keys.saturating_add((head * len) as u32), len)
    }

    pub(super) fn values<'w>(
        &self,
        weights: &'w [f32],
        head: usize,
    ) -> Result<&'w [f32], DecideError> {
        let len = self.values_len();
        slice(weights, self.values.saturating_add((head * len) as u32), len)
    }
}

/// Mixes rows by one head's scores.
#[inline(always)]
pub(super) fn attend(
    kernels: impl Kernels,
    rows: Rows<'_>,
    absorbed: &[f32],
    scores: &mut [f32],
    mixed: &mut [f32],
) -> Result<(), DecideError> {
    kernels.mix(weigh(kernels, rows, absorbed, scores)?, rows, mixed);
    Ok(())
}

/// The weights of rows in one head.
#[inline(always)]
fn weigh<'s>(
    kernels: impl Kernels,
    rows: Rows<'_>,
    absorbed: &[f32],
    scores: &'s mut [f32],
) -> Result<&'s [f32], DecideError> {
    let visible = rows.slots.len();
    let scores = scores.get_mut(..slots(visible)).ok_or(DecideError::BadLength)?;
    if visible > 1 {
        kernels.dots(absorbed, rows, scores);
        if !kernels.softmax(scores, visible) {
            return Err(DecideError::NonFinite);
        }
    } else {
        // The weight of a single entity is one, whatever its score.
        scores.fill(1.0);
    }
    Ok(scores)
}
