//! Multi-head attention of the agent's own query, with int8 weights.

use heapless::Vec;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::int8_layer::{
    Between, From, Int8Layer, Int8Shape, as_inputs, as_integers, integers, product,
    quantised_floats, team_products,
};
use super::int8_rows::{rows, rows_floats};
use super::operator::Operator;
use super::team::{Member, TEAM, Team};
use super::{Flag, LAYOUT_INT8, Place, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::int8::{
    IntegerRows, Matrix, Reach, Scale, Vector, input_max, mixing_max, row_max,
};
use crate::kernels::product::padded;
use crate::kernels::rows::first_slots;
use crate::kernels::softmax::{Scores, slots};
use crate::policy::{DecideError, Observation};

/// As [`super::AttendOwn`]: queries, absorbed keys, values and output are int8 products. Rows are integers, which absorbed keys
/// are compared with as integers, and which are mixed by weights that are integers; scores and their softmax are f32.
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
    /// u of one head, then z of it in i32: E floats, rounded up to a multiple of 32.
    pub absorbed: Place,
    /// Scores of one head, `[n_max]`.
    pub scores: Place,
    /// o of all heads, as many floats as the output layer has inputs.
    pub attended: Place,
    /// The result, padded. It may stand where the query, u or scores stood.
    pub to: Place,
    /// Integers: the inputs of a product, u, the weights of rows.
    pub quantised: Place,
}

impl Operator for Int8AttendOwn {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        let (heads, head_width) = (usize::from(self.heads), self.head_width());
        let all = |len: usize| (heads as u64).saturating_mul(len as u64);
        let matrices = [
            (self.keys, self.keys_len() as u64),
            (self.key_steps, all(self.key_shape().columns())),
            (self.values, self.values_len() as u64),
            (self.value_steps, all(self.value_shape().columns())),
        ];
        let layers = self.query.check(sizes)
            && self.output.check(sizes)
            && matrices.iter().all(|(offset, len)| sizes.holds_weights(*offset, *len));
        let widths = head_width > 0
            && head_width == padded(head_width)
            && all(head_width) == u64::from(self.query.outputs)
            && self.query.inputs == self.width
            && self.has_inputs(self.output.inputs);
        let longest = usize::from(self.width.max(self.output.inputs));
        let lengths = u64::from(self.rows.len) == rows_floats(sizes.n_max, self.width)
            && self.query_place.len == u32::from(self.query.outputs)
            && self.absorbed.len as usize == 2 * quantised_floats(self.width.into())
            && self.scores.len == sizes.n_max
            && self.attended.len == u32::from(self.output.inputs)
            && self.to.len as usize == self.output.padded_outputs()
            && self.quantised.len as usize == quantised_floats(longest.max(sizes.n_max as usize));
        layers
            && widths
            && lengths
            && sizes.hold_apart(&self.places().each_ref())
            && sizes.hold_apart(&[&self.attended, &self.quantised, &self.to])
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        let heads = [self.key_shape(), self.value_shape()].map(Int8Shape::multiply_adds);
        let layers = [self.query, self.output].map(|layer| layer.shape().multiply_adds());
        let rows = 2 * visible * padded(usize::from(self.width)) as u64;
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
        let Scratch { visible, own, .. } = *scratch;
        let [floats, query, absorbed, scores, attended, quantised] =
            places(scratch.floats, self.places().each_ref())?;
        let rows = rows(floats, self.width.into(), first_slots(visible))?;
        let (own, step) = rows.row(own as u16);
        self.keep(own, step, attended);
        if visible > 1 {
            let vector = Vector { inputs: as_inputs(own), step, outputs: query };
            kernels.int8_products(&self.query.matrix(weights, false)?, &mut [vector]);
        }
        let head_width = self.head_width().max(1);
        let heads = query.chunks_exact(head_width).zip(attended.chunks_exact_mut(head_width));
        for (head, (query, outputs)) in (0..self.heads).zip(heads) {
            if visible == 0 {
                outputs.fill(0.0);
                continue;
            }
            if visible > 1 {
                product(kernels, &self.keys(weights, head)?, query, quantised, absorbed)?;
            }
            let step = self.attend(kernels, rows, [absorbed, scores, quantised])?;
            let vector = Vector { inputs: as_inputs(as_integers(quantised)?), step, outputs };
            kernels.int8_products(&self.values(weights, head)?, &mut [vector]);
        }
        let wanted = [&self.attended, &self.quantised, &self.to];
        let [attended, quantised, to] = places(scratch.floats, wanted)?;
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
        let (step, quantised) = (self.head_width(), &self.quantised);
        let own_steps = self.keep_team(team)?;
        let between =
            Between { from: From::Quantised(&own_steps), quantised, to: &self.query_place };
        team_products(kernels, &self.query.matrix(weights, false)?, team, between, asks)?;
        for head in 0..self.heads {
            let start = usize::from(head) * step;
            let part = |place: &Place| place.part(start..start + step);
            let (query, outputs) = (part(&self.query_place), part(&self.attended));
            let between = Between { from: From::Floats(&query), quantised, to: &self.absorbed };
            team_products(kernels, &self.keys(weights, head)?, team, between, asks)?;
            let steps = self.attend_team(kernels, team)?;
            let between = Between { from: From::Quantised(&steps), quantised, to: &outputs };
            team_products(kernels, &self.values(weights, head)?, team, between, sees)?;
        }
        let matrix = self.output.matrix(weights, self.relu.is_set())?;
        let between = Between { from: From::Floats(&self.attended), quantised, to: &self.to };
        team_products(kernels, &matrix, team, between, |_| true)
    }
}

impl Int8AttendOwn {
    /// Outputs of a head, those of padding included.
    fn head_width(&self) -> usize {
        usize::from(self.query.outputs).checked_div(usize::from(self.heads)).unwrap_or(0)
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

    /// Floats of W_k of all heads.
    pub fn keys_len(&self) -> usize {
        usize::from(self.heads).saturating_mul(self.key_shape().weights_len())
    }

    /// Floats of W_v of all heads.
    pub fn values_len(&self) -> usize {
        usize::from(self.heads).saturating_mul(self.value_shape().weights_len())
    }

    fn key_shape(&self) -> Int8Shape {
        Int8Shape { inputs: self.head_width(), outputs: usize::from(self.width) }
    }

    fn value_shape(&self) -> Int8Shape {
        Int8Shape { inputs: usize::from(self.width), outputs: self.head_width() }
    }

    /// All places but that of the result.
    fn places(&self) -> [Place; 6] {
        // Scores are worked on in whole vectors, for which a plan leaves room behind the last one.
        let scores = Place { len: slots(self.scores.len as usize) as u32, ..self.scores };
        let Self { rows, query_place, absorbed, attended, quantised, .. } = *self;
        [rows, query_place, absorbed, scores, attended, quantised]
    }

    /// Keeps the own row for the output layer, where there is a skip.
    fn keep(&self, own: &[i16], step: f32, attended: &mut [f32]) {
        if self.skips() {
            let kept = attended.iter_mut().skip(self.query.outputs.into());
            for (to, integer) in kept.zip(own) {
                *to = f32::from(*integer) * step;
            }
        }
    }

    /// Mixes rows by one head's u, and leaves z among the quantised. Returns what an integer of z counts.
    #[inline(always)]
    fn attend(
        &self,
        kernels: impl Kernels,
        rows: IntegerRows<'_>,
        [absorbed, scores, quantised]: [&mut [f32]; 3],
    ) -> Result<f32, DecideError> {
        let visible = rows.slots.len();
        if visible > 1 {
            self.score(kernels, rows, [absorbed, scores, quantised])?;
            let scores = scores.get_mut(..slots(visible)).ok_or(DecideError::BadLength)?;
            if !kernels.softmax(scores, visible) {
                return Err(DecideError::NonFinite);
            }
        }
        self.mix(kernels, rows, [absorbed, scores, quantised])
    }

    /// The scores of rows by one head's u.
    #[inline(always)]
    fn score(
        &self,
        kernels: impl Kernels,
        rows: IntegerRows<'_>,
        [absorbed, scores, quantised]: [&mut [f32]; 3],
    ) -> Result<(), DecideError> {
        let (width, most) = (usize::from(self.width), row_max(rows.width));
        let u = absorbed.get(..width).ok_or(DecideError::BadLength)?;
        let vector = integers(quantised, width)?;
        let scale = kernels.quantise(u, Reach { least: 0.0, most }, vector);
        let Scale { step, .. } = scale.ok_or(DecideError::NonFinite)?;
        kernels.int8_dots(vector, step, rows, scores);
        Ok(())
    }

    /// Mixes rows by their weights, and leaves z among the quantised. Returns what an integer of z counts.
    #[inline(always)]
    fn mix(
        &self,
        kernels: impl Kernels,
        rows: IntegerRows<'_>,
        [absorbed, scores, quantised]: [&mut [f32]; 3],
    ) -> Result<f32, DecideError> {
        let (width, visible) = (usize::from(self.width), rows.slots.len());
        if let [slot] = rows.slots {
            // The weight of a single entity is one, whatever its score.
            let (row, step) = rows.row(*slot);
            copy(row, integers(quantised, width)?);
            return Ok(step);
        }
        let bad = DecideError::NonFinite;
        for (weight, slot) in scores.iter_mut().zip(rows.slots) {
            *weight *= rows.row(*slot).1;
        }
        let weights = integers(quantised, visible)?;
        let reach = Reach { least: 0.0, most: mixing_max(visible, rows.width) };
        let scores = scores.get(..visible).ok_or(DecideError::BadLength)?;
        let Scale { step, .. } = kernels.quantise(scores, reach, weights).ok_or(bad)?;
        let sums = <[i32]>::mut_from_bytes(absorbed.as_mut_bytes());
        let sums = sums.map_err(|_| DecideError::BadLength)?;
        kernels.int8_mix(weights, rows, sums);
        let inputs = integers(quantised, width)?;
        Ok(step * kernels.narrow(sums, input_max(inputs.len()), inputs))
    }

    /// Keeps every member's own row among its quantised, and for the output layer where there is a skip. Returns what an
    /// integer of each counts.
    fn keep_team(&self, team: &mut Team<'_>) -> Result<[f32; TEAM], DecideError> {
        let [attended, quantised] =
            [self.attended, self.quantised].map(|place| team.own_place(&place));
        let Team { rows: floats, own, own_floats, members, .. } = team;
        let rows = rows(floats, self.width.into(), &[])?;
        let mut steps = [0.0; TEAM];
        let members = members.iter().zip(own.chunks_exact_mut((*own_floats).max(1)));
        for ((member, floats), step_of) in members.zip(&mut steps) {
            let [attended, quantised] = places(floats, [&attended, &quantised])?;
            let (row, step) = rows.row(member.own.into());
            copy(row, integers(quantised, self.width.into())?);
            self.keep(row, step, attended);
            *step_of = step;
        }
        Ok(steps)
    }

    /// Mixes rows by one head's u for every member, see [`Self::attend`]; who sees nothing gets zeros.
    fn attend_team(
        &self,
        kernels: impl Kernels,
        team: &mut Team<'_>,
    ) -> Result<[f32; TEAM], DecideError> {
        let [_, _, absorbed, scores, attended, quantised] = self.places();
        let wanted = [absorbed, scores, attended, quantised].map(|place| team.own_place(&place));
        let Team { rows: floats, own, own_floats, members, .. } = team;
        let mut asked: Vec<Scores<'_>, TEAM> = Vec::new();
        for (member, own) in members.iter_mut().zip(own.chunks_exact_mut((*own_floats).max(1))) {
            let [absorbed, scores, attended, quantised] = places(own, wanted.each_ref())?;
            let mut count = member.slots.len();
            if count == 0 {
                let heads = attended.get_mut(..self.query.outputs.into());
                heads.ok_or(DecideError::BadLength)?.fill(0.0);
            }
            if count > 1 {
                let rows = rows(floats, self.width.into(), &member.slots)?;
                member.alone |= self.score(kernels, rows, [absorbed, scores, quantised]).is_err();
            } else {
                count = 0;
            }
            let scores = scores.get_mut(..slots(count)).ok_or(DecideError::BadLength)?;
            // There is room for every member.
            let _ = asked.push(Scores { scores, count, finite: true });
        }
        kernels.softmaxes(&mut asked);
        // By reference, as a vector that is taken apart ends with a slice that could fail.
        for (member, scores) in members.iter_mut().zip(&asked) {
            member.alone |= !scores.finite;
        }
        drop(asked);
        let mut steps = [0.0; TEAM];
        let own = own.chunks_exact_mut((*own_floats).max(1));
        for ((member, own), step) in members.iter_mut().zip(own).zip(&mut steps) {
            if member.alone || member.slots.is_empty() {
                continue;
            }
            let [absorbed, scores, _, quantised] = places(own, wanted.each_ref())?;
            let rows = rows(floats, self.width.into(), &member.slots)?;
            match self.mix(kernels, rows, [absorbed, scores, quantised]) {
                Ok(of_member) => *step = of_member,
                Err(_) => member.alone = true,
            }
        }
        Ok(steps)
    }

    fn keys<'w>(&self, weights: &'w [f32], head: u16) -> Result<Matrix<'w>, DecideError> {
        of_head(self.key_shape(), weights, (self.keys, self.key_steps), head)
    }

    fn values<'w>(&self, weights: &'w [f32], head: u16) -> Result<Matrix<'w>, DecideError> {
        of_head(self.value_shape(), weights, (self.values, self.value_steps), head)
    }
}

/// Without a way to a panic.
fn copy(from: &[i16], to: &mut [i16]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
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
