//! Multi-head attention of the agent's own query, with int8 weights.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::attend_own::attend;
use super::int8_layer::{
    Between, From, Int8Layer, Int8Shape, product, quantised_floats, team_products,
};
use super::operator::Operator;
use super::team::{Member, Team};
use super::{Flag, LAYOUT_INT8, Place, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::int8::Matrix;
use crate::kernels::product::padded;
use crate::kernels::rows::Rows;
use crate::kernels::softmax::slots;
use crate::policy::{DecideError, Observation};

/// As [`super::AttendOwn`]: queries, absorbed keys, values and output are int8 products, each of whose inputs are
/// quantised anew; scores, their softmax and the mixed rows stay f32.
///
/// Every head has the query's outputs divided by the heads, a multiple of eight: what a narrower head has beyond
/// its width has weights of zero. The output layer takes the own row as well where there is a skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8AttendOwn {
    /// The embeddings that [`super::Int8EmbedEntities`] wrote.
    pub rows: Place,
    /// Width E of an embedding.
    pub width: u16,
    /// Heads.
    pub heads: u16,
    /// W_q, divided by the root of the head width.
    pub query: Int8Layer,
    /// W_k: for every head a matrix of E outputs.
    pub keys: u32,
    /// What the weights of W_k count, for every head whole strips.
    pub key_steps: u32,
    /// W_v: for every head a matrix of E inputs.
    pub values: u32,
    /// What the weights of W_v count, for every head whole strips.
    pub value_steps: u32,
    /// W_o.
    pub output: Int8Layer,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// q.
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
    /// The quantised inputs of a product.
    pub quantised: Place,
}

impl Operator for Int8AttendOwn {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        let (heads, head_width) = (usize::from(self.heads), self.head_width());
        let rows = (u64::from(sizes.n_max) + 1).saturating_mul(self.padded_width() as u64);
        let all = |len: usize| (heads as u64).saturating_mul(len as u64);
        let matrices = [
            (self.keys, self.key_shape().weights_len()),
            (self.key_steps, self.key_shape().columns()),
            (self.values, self.value_shape().weights_len()),
            (self.value_steps, self.value_shape().columns()),
        ];
        let layers = self.query.check(sizes)
            && self.output.check(sizes)
            && matrices.iter().all(|(offset, len)| sizes.holds_weights(*offset, all(*len)));
        let widths = head_width > 0
            && head_width == padded(head_width)
            && all(head_width) == u64::from(self.query.outputs)
            && self.query.inputs == self.width
            && self.has_inputs(self.output.inputs);
        let longest = usize::from(self.width.max(self.output.inputs));
        let lengths = u64::from(self.rows.len) == rows
            && self.query_place.len == u32::from(self.query.outputs)
            && self.absorbed.len as usize == self.padded_width()
            && self.scores.len == sizes.n_max
            && self.mixed.len as usize == self.padded_width()
            && self.attended.len == u32::from(self.output.inputs)
            && self.to.len as usize == self.output.padded_outputs()
            && self.quantised.len as usize == quantised_floats(longest);
        layers && widths && lengths && sizes.hold_apart(&self.places().each_ref())
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        let heads = [self.key_shape(), self.value_shape()].map(Int8Shape::multiply_adds);
        let layers = [self.query, self.output].map(|layer| layer.shape().multiply_adds());
        let rows = 2 * visible * self.padded_width() as u64;
        let per_head = heads.iter().sum::<u64>() + rows;
        layers.iter().sum::<u64>() + u64::from(self.heads) * per_head
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
        let [rows, query, absorbed, scores, mixed, attended, to, quantised] =
            places(scratch.floats, self.places().each_ref())?;
        let width = usize::from(self.width);
        let start = scratch.own.saturating_mul(self.padded_width());
        let own = rows.get(start..start.saturating_add(width)).ok_or(DecideError::BadLength)?;
        if self.skips() {
            let kept = attended.get_mut(usize::from(self.query.outputs)..);
            for (to, from) in kept.ok_or(DecideError::BadLength)?.iter_mut().zip(own) {
                *to = *from;
            }
        }
        if visible > 1 {
            product(kernels, &self.query.matrix(weights, false)?, own, quantised, query)?;
        }
        let rows = Rows::first(rows, self.padded_width(), visible);
        let head_width = self.head_width().max(1);
        let heads = query.chunks_exact(head_width).zip(attended.chunks_exact_mut(head_width));
        for (head, (query, output)) in (0..self.heads).zip(heads) {
            if visible == 0 {
                output.fill(0.0);
                continue;
            }
            if visible > 1 {
                product(kernels, &self.keys(weights, head)?, query, quantised, absorbed)?;
            }
            attend(kernels, rows, absorbed, scores, mixed)?;
            let mixed = mixed.get(..width).ok_or(DecideError::BadLength)?;
            product(kernels, &self.values(weights, head)?, mixed, quantised, output)?;
        }
        product(kernels, &self.output.matrix(weights, self.relu.is_set())?, attended, quantised, to)
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
        let asks = |member: &Member| member.slots.len() > 1;
        let sees = |member: &Member| !member.slots.is_empty();
        let (width, step, quantised) =
            (usize::from(self.width), self.head_width(), &self.quantised);
        let between = Between { from: From::Rows(width), quantised, to: &self.query_place };
        team_products(kernels, &self.query.matrix(weights, false)?, team, between, asks)?;
        for head in 0..self.heads {
            let start = usize::from(head) * step;
            let part = |place: &Place| place.part(start..start + step);
            let (query, output) = (part(&self.query_place), part(&self.attended));
            let between = Between { from: From::Own(&query), quantised, to: &self.absorbed };
            team_products(kernels, &self.keys(weights, head)?, team, between, asks)?;
            self.attend_team(kernels, team)?;
            let mixed = self.mixed.part(0..width);
            let between = Between { from: From::Own(&mixed), quantised, to: &output };
            team_products(kernels, &self.values(weights, head)?, team, between, sees)?;
        }
        if self.skips() {
            let kept = self.attended.part(self.query.outputs.into()..self.attended.len as usize);
            team.keep_own_rows(width, &kept);
        }
        let matrix = self.output.matrix(weights, self.relu.is_set())?;
        let between = Between { from: From::Own(&self.attended), quantised, to: &self.to };
        team_products(kernels, &matrix, team, between, |_| true)
    }
}

impl Int8AttendOwn {
    /// Outputs of a head, those of padding included.
    fn head_width(&self) -> usize {
        usize::from(self.query.outputs).checked_div(usize::from(self.heads)).unwrap_or(0)
    }

    fn padded_width(&self) -> usize {
        padded(usize::from(self.width))
    }

    /// Whether the output layer may have so many inputs: those of the heads, and with a skip the own row's.
    fn has_inputs(&self, inputs: u16) -> bool {
        let rest = inputs.checked_sub(self.query.outputs);
        rest.is_some_and(|rest| [0, self.width].contains(&rest))
    }

    /// Whether the output layer takes the own row as well.
    pub fn skips(&self) -> bool {
        self.output.inputs > self.query.outputs
    }

    fn key_shape(&self) -> Int8Shape {
        Int8Shape { inputs: self.head_width(), outputs: usize::from(self.width) }
    }

    fn value_shape(&self) -> Int8Shape {
        Int8Shape { inputs: usize::from(self.width), outputs: self.head_width() }
    }

    fn places(&self) -> [Place; 8] {
        // Scores are worked on in whole vectors, for which a plan leaves room behind the last one.
        let scores = Place { len: slots(self.scores.len as usize) as u32, ..self.scores };
        let Self { rows, query_place, absorbed, mixed, attended, to, quantised, .. } = *self;
        [rows, query_place, absorbed, scores, mixed, attended, to, quantised]
    }

    /// Mixes rows by one head's scores for every member; who sees nothing gets zeros.
    fn attend_team(&self, kernels: impl Kernels, team: &mut Team<'_>) -> Result<(), DecideError> {
        let [_, _, absorbed, scores, mixed, attended, _, _] = self.places();
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

    fn keys<'w>(&self, weights: &'w [f32], head: u16) -> Result<Matrix<'w>, DecideError> {
        of_head(self.key_shape(), weights, (self.keys, self.key_steps), head)
    }

    fn values<'w>(&self, weights: &'w [f32], head: u16) -> Result<Matrix<'w>, DecideError> {
        of_head(self.value_shape(), weights, (self.values, self.value_steps), head)
    }
}

/// One head's matrix; weights and steps of all heads stand one behind the other.
fn of_head(
    shape: Int8Shape,
    floats: &[f32],
    (weights, steps): (u32, u32),
    head: u16,
) -> Result<Matrix<'_>, DecideError> {
    let of =
        |start: u32, len: usize| start.saturating_add(u32::from(head).saturating_mul(len as u32));
    shape.matrix(floats, of(weights, shape.weights_len()), of(steps, shape.columns()))
}
