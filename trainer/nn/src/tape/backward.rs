//! The way back: from the slope of the loss to those of all parameters, step by step.

use std::mem;
use std::ops::Range;

use super::{Attended, Gru, Indices, Linear, Node, Operation, Pass, Tape, Var};
use crate::layers::attention::{AttentionShape, Backward};
use crate::layers::gru::GruShape;
use crate::layers::matrix::Store;
use crate::layers::{
    attention, elementwise, linear, normalise, softmax, sparse_linear, split_attention, unfold,
};

impl Pass<'_> {
    /// Adds to `gradient`, which has a number for every parameter, that of a loss, a matrix of one number.
    ///
    /// To be called once a pass.
    pub fn backward(&mut self, loss: Var, gradient: &mut [f32]) {
        assert_eq!(self.size(loss), [1, 1], "a loss is one number");
        assert!(self.tape.goes_back, "a pass that only looks has no way back");
        let Some((range, _)) = self.tape.slopes_of(loss) else { return };
        self.tape.slopes[range].fill(1.0);
        for index in (0..=loss.0).rev() {
            let node = self.tape.nodes[index as usize];
            if node.has_slopes && node.needs_slopes {
                self.tape.descend(node.operation, node.range(), self.parameters, gradient);
            }
        }
    }
}

impl Tape {
    /// Goes back through one step whose results and slopes stand at `own`.
    fn descend(
        &mut self,
        operation: Operation,
        own: Range<usize>,
        parameters: &[f32],
        gradient: &mut [f32],
    ) {
        match operation {
            Operation::Given => {}
            Operation::Linear { x, layer, rectified } => {
                if rectified {
                    self.descend_rectified(own.clone());
                }
                self.descend_linear(x, layer, own, parameters, gradient);
            }
            Operation::LinearSum { x, layers } => {
                self.descend_rectified(own.clone());
                for (x, layer) in x.into_iter().zip(layers) {
                    self.descend_linear(x, layer, own.clone(), parameters, gradient);
                }
            }
            Operation::SparseLinear { rows, layer, rectified, .. } => {
                if rectified {
                    self.descend_rectified(own.clone());
                }
                let bias = layer.bias_range().expect("sparse layers have offsets");
                let tensors = gradient.get_disjoint_mut([layer.weight_range(), bias]);
                let [weight, bias] = tensors.expect("tensors beside each other");
                let rows = &self.sparse.things[rows];
                sparse_linear::backward(rows, &self.slopes[own], weight, bias);
            }
            Operation::Activate { x, activation } => self.from(x, own, |store, _, y, d_y, d_x| {
                elementwise::activate_backward(activation, y, d_y, store, d_x);
            }),
            Operation::Softmax { x } => self.through_rows(x, own, softmax::backward),
            Operation::LogSoftmax { x } => self.through_rows(x, own, softmax::log_backward),
            Operation::Attend { inputs, lists, kept, shape, to, .. } => {
                self.descend_attention(inputs, [lists, kept], shape, to, own);
            }
            Operation::Recur { x, pass, carry, slots, layer } => {
                self.descend_gru(x, [pass, carry, slots], layer, own, parameters, gradient);
            }
            Operation::Unfold { x, shape } => {
                self.added(x, (0, 0), own, |_, d_y, d_x| unfold::backward(shape, d_y, d_x));
            }
            Operation::Gather { x, indices } => {
                let columns = self.of(x).columns;
                self.added(x, indices, own, |rows, d_y, d_x| {
                    for (row, d_y) in rows.iter().zip(d_y.chunks_exact(columns)) {
                        let d_x = &mut d_x[*row as usize * columns..][..columns];
                        elementwise::scale(1.0, d_y, Store::Add, d_x);
                    }
                });
            }
            Operation::Scatter { x, indices } => {
                let columns = self.of(x).columns;
                self.added(x, indices, own, |rows, d_y, d_x| {
                    for (row, d_x) in rows.iter().zip(d_x.chunks_exact_mut(columns)) {
                        let d_y = &d_y[*row as usize * columns..][..columns];
                        elementwise::scale(1.0, d_y, Store::Add, d_x);
                    }
                });
            }
            Operation::Pick { x, indices } => {
                let width = self.of(x).columns;
                self.added(x, indices, own, |columns, d_y, d_x| {
                    let rows = d_x.chunks_exact_mut(width).zip(d_y);
                    for ((d_x, d_y), column) in rows.zip(columns) {
                        d_x[*column as usize] += d_y;
                    }
                });
            }
            Operation::Columns { x, first } => {
                let Node { rows, columns: width, .. } = self.of(x);
                self.added(x, (0, 0), own, |_, d_y, d_x| {
                    let columns = d_y.len() / rows.max(1);
                    let slopes = d_x.chunks_exact_mut(width).zip(d_y.chunks_exact(columns));
                    for (d_x, d_y) in slopes {
                        let d_x = &mut d_x[first..][..columns];
                        elementwise::scale(1.0, d_y, Store::Add, d_x);
                    }
                });
            }
            Operation::Concat { parts } => self.descend_concat(parts, own),
            Operation::SumColumns { x } => {
                let width = self.of(x).columns;
                self.from(x, own, |store, _, _, d_y, d_x| {
                    for (d_x, d_y) in d_x.chunks_exact_mut(width).zip(d_y) {
                        match store {
                            Store::Replace => d_x.fill(*d_y),
                            Store::Add => d_x.iter_mut().for_each(|d_x| *d_x += d_y),
                        }
                    }
                });
            }
            Operation::Scale { x, factor } => self.from(x, own, |store, _, _, d_y, d_x| {
                elementwise::scale(factor, d_y, store, d_x);
            }),
            Operation::Add { a, b } => {
                for x in [a, b] {
                    self.from(x, own.clone(), |store, _, _, d_y, d_x| {
                        // The second may have been added to several blocks.
                        for (block, d_y) in d_y.chunks_exact(d_x.len().max(1)).enumerate() {
                            let store = if block == 0 { store } else { Store::Add };
                            elementwise::scale(1.0, d_y, store, d_x);
                        }
                    });
                }
            }
            Operation::Multiply { a, b } => {
                for (x, other) in [(a, b), (b, a)] {
                    let other = self.of(other).range();
                    self.from(x, own.clone(), |store, values, _, d_y, d_x| {
                        elementwise::multiply(&values[other], d_y, store, d_x);
                    });
                }
            }
            Operation::ScaleRows { x, by } => self.descend_scale_rows(x, by, own),
            Operation::Dueling { value, advantages } => {
                let columns = self.of(advantages).columns;
                self.from(value, own.clone(), |store, _, _, d_y, d_x| {
                    for (d_x, d_y) in d_x.iter_mut().zip(d_y.chunks_exact(columns)) {
                        let sum = d_y.iter().sum::<f32>();
                        *d_x = if store == Store::Add { *d_x + sum } else { sum };
                    }
                });
                self.through(advantages, own, |_, _, d_x| {
                    for d_x in d_x.chunks_exact_mut(columns) {
                        let mean = d_x.iter().sum::<f32>() / columns as f32;
                        d_x.iter_mut().for_each(|d_x| *d_x -= mean);
                    }
                });
            }
            Operation::SquaredError { x, target, factor } => {
                self.descend_loss(x, target, own, |x, target, d_y| {
                    2.0 * (factor * d_y) * (x - target)
                });
            }
            Operation::Huber { x, target, factor, bound } => {
                self.descend_loss(x, target, own, |x, target, d_y| {
                    factor * d_y * (x - target).clamp(-bound, bound)
                });
            }
            Operation::SoftmaxGroups { x, indices, groups } => {
                self.descend_softmax_groups(x, indices, groups, own);
            }
            Operation::Parameter { start } => {
                let place = start..start + own.len();
                elementwise::scale(1.0, &self.slopes[own], Store::Add, &mut gradient[place]);
            }
            Operation::Product { a, b, transposed } => self.descend_product(a, b, transposed, own),
            Operation::Absolute { x } => {
                let range = self.of(x).range();
                self.from(x, own, |store, values, _, d_y, d_x| {
                    elementwise::absolute_backward(&values[range], d_y, store, d_x);
                });
            }
            Operation::NormaliseRows { x } => {
                let (range, columns) = (self.of(x).range(), self.of(x).columns);
                self.from(x, own, |store, values, y, d_y, d_x| {
                    let known = [&values[range], y, d_y];
                    normalise::rows_backward(columns, known, store, d_x);
                });
            }
            Operation::Absorb { inputs, keys_values, lists, pass, heads, .. } => {
                let weight = keys_values.weight_range();
                let matrix = (&parameters[weight.clone()], &mut gradient[weight]);
                self.descend_absorbed(inputs, matrix, [lists, pass, heads], own);
            }
            Operation::AttendInTeams { inputs, lists, weights, heads, sums } => {
                self.descend_teams(inputs, [lists, weights, heads], sums, own);
            }
        }
    }

    fn descend_rectified(&mut self, own: Range<usize>) {
        elementwise::rectify_backward(&self.values[own.clone()], &mut self.slopes[own]);
    }

    fn descend_linear(
        &mut self,
        x: Var,
        layer: Linear,
        own: Range<usize>,
        parameters: &[f32],
        gradient: &mut [f32],
    ) {
        let range = self.of(x).range();
        let d_y = &self.slopes[own.clone()];
        let d_weight = &mut gradient[layer.weight_range()];
        linear::backward_weight(layer.shape, &self.values[range], d_y, d_weight);
        if let Some(bias) = layer.bias_range() {
            linear::backward_bias(d_y, &mut gradient[bias]);
        }
        self.from(x, own, |store, _, _, d_y, d_x| {
            let weight = &parameters[layer.weight_range()];
            linear::backward_input(layer.shape, d_y, weight, store, d_x);
        });
    }

    fn descend_gru(
        &mut self,
        x: Var,
        [pass, carry, slots]: [usize; 3],
        layer: Gru,
        own: Range<usize>,
        parameters: &[f32],
        gradient: &mut [f32],
    ) {
        let (range, shape) = (self.of(x).range(), GruShape { width: layer.width, slots });
        self.descend_into([x], 0, own, |tape, d_y, [d_x], _| {
            let carry = &tape.carry[carry..][..range.len() / layer.width];
            tape.grus.things[pass].backward(
                shape,
                &parameters[layer.range()],
                (&tape.values[range], carry),
                (d_y, d_x),
                &mut gradient[layer.range()],
            );
        });
    }

    fn descend_concat(&mut self, parts: Indices, own: Range<usize>) {
        let mut first = 0;
        for part in parts.0..parts.1 {
            let part = Var(self.indices[part]);
            let Node { rows, columns, .. } = self.of(part);
            self.from(part, own.clone(), |store, _, _, d_y, d_x| {
                // Of no rows nothing is known of their width, nor needed.
                let width = (d_y.len() / rows.max(1)).max(1);
                for (d_x, d_y) in d_x.chunks_exact_mut(columns).zip(d_y.chunks_exact(width)) {
                    elementwise::scale(1.0, &d_y[first..first + columns], store, d_x);
                }
            });
            first += columns;
        }
    }

    fn descend_scale_rows(&mut self, x: Var, by: Var, own: Range<usize>) {
        let columns = self.of(x).columns;
        let (rows, factors) = (self.of(x).range(), self.of(by).range());
        self.from(x, own.clone(), |store, values, _, d_y, d_x| {
            let slopes = d_x.chunks_exact_mut(columns).zip(d_y.chunks_exact(columns));
            for ((d_x, d_y), by) in slopes.zip(&values[factors]) {
                elementwise::scale(*by, d_y, store, d_x);
            }
        });
        self.from(by, own, |store, values, _, d_y, d_by| {
            let rows = values[rows].chunks_exact(columns).zip(d_y.chunks_exact(columns));
            for (d_by, (x, d_y)) in d_by.iter_mut().zip(rows) {
                let slope = elementwise::dot(x, d_y);
                *d_by = if store == Store::Add { *d_by + slope } else { slope };
            }
        });
    }

    fn descend_loss(
        &mut self,
        x: Var,
        target: Var,
        own: Range<usize>,
        slope: impl Fn(f32, f32, f32) -> f32,
    ) {
        let (inputs, targets) = (self.of(x).range(), self.of(target).range());
        self.from(x, own, |store, values, _, d_y, d_x| {
            let pairs = values[inputs].iter().zip(&values[targets]);
            for (d_x, (x, target)) in d_x.iter_mut().zip(pairs) {
                let slope = slope(*x, *target, d_y[0]);
                *d_x = if store == Store::Add { *d_x + slope } else { slope };
            }
        });
    }

    /// Through queries, keys and values.
    fn descend_attention(
        &mut self,
        inputs: [Var; 2],
        [lists, kept]: [usize; 2],
        shape: AttentionShape,
        to: Attended,
        own: Range<usize>,
    ) {
        let (ranges, results) = (inputs.map(|var| self.of(var).range()), own.clone());
        let pairs = self.lists.things[lists].pairs() * shape.heads;
        self.descend_into(inputs, pairs, own, |tape, d_output, d_inputs, d_scores| {
            let (visible, values) = (&tape.lists.things[lists], &tape.values);
            let [queries, keys_values] = ranges.map(|range| &values[range]);
            let [d_queries, d_keys_values] = d_inputs;
            let (of_pairs, shares) = values[kept..].split_at(pairs);
            let pass = Backward {
                queries,
                keys_values,
                of_pairs,
                shares,
                output: &values[results],
                d_output,
                d_scores,
                d_queries,
                d_keys_values,
            };
            match to {
                Attended::Scores => attention::squared_scores_backward(shape, visible, pass),
                Attended::Whole if !split_attention::is_built_for(shape.width, shape.heads) => {
                    attention::backward(shape, visible, pass);
                }
                _ => split_attention::backward(shape.width, visible, pass),
            }
        });
    }
}

/// Where steps put the slopes by their inputs: in the place of nothing, or added to those of other steps.
impl Tape {
    /// Has `write` store the slopes by `x`, from all values before the step, its results and its slopes.
    pub(super) fn from(
        &mut self,
        x: Var,
        own: Range<usize>,
        write: impl FnOnce(Store, &[f32], &[f32], &[f32], &mut [f32]),
    ) {
        let Some((range, store)) = self.slopes_of(x) else { return };
        let (before, rest) = self.slopes.split_at_mut(own.start);
        let (values, results) = self.values.split_at(own.start);
        write(store, values, &results[..own.len()], &rest[..own.len()], &mut before[range]);
    }

    /// Has `write` make slopes by inputs of those by the results, in so much space besides.
    ///
    /// They are written where they belong if nothing stands there yet.
    pub(super) fn descend_into<const N: usize>(
        &mut self,
        inputs: [Var; N],
        space: usize,
        own: Range<usize>,
        write: impl FnOnce(&mut Self, &[f32], [&mut [f32]; N], &mut [f32]),
    ) {
        let mut places = [const { None }; N];
        for (place, x) in places.iter_mut().zip(inputs).rev() {
            *place = self.slopes_of(x);
        }
        let are_empty = places.iter().all(|place| matches!(place, Some((_, Store::Replace))));
        let ranges = inputs.map(|x| self.of(x).range());
        let (mut slopes, mut scratch) = (mem::take(&mut self.slopes), mem::take(&mut self.scratch));
        let (before, rest) = slopes.split_at_mut(own.start);
        let numbers = if are_empty { 0 } else { ranges.iter().map(Range::len).sum() };
        let (space, mut rest_of_space) = sized(&mut scratch, space + numbers).split_at_mut(space);
        if are_empty {
            let d_x = before.get_disjoint_mut(ranges).expect("inputs apart from each other");
            write(self, &rest[..own.len()], d_x, space);
        } else {
            let part = |range: Range<usize>| rest_of_space.split_off_mut(..range.len());
            let mut computed = ranges.map(part).map(|part| part.expect("room for all inputs"));
            write(self, &rest[..own.len()], computed.each_mut().map(|d_x| &mut **d_x), space);
            for (place, computed) in places.into_iter().zip(&computed).rev() {
                if let Some((range, store)) = place {
                    elementwise::scale(1.0, computed, store, &mut before[range]);
                }
            }
        }
        (self.slopes, self.scratch) = (slopes, scratch);
    }

    /// Has `turn` make slopes by `x` of those by the results, from input and results.
    pub(super) fn through(
        &mut self,
        x: Var,
        own: Range<usize>,
        turn: impl FnOnce(&[f32], &[f32], &mut [f32]),
    ) {
        let (range, results) = (self.of(x).range(), own.clone());
        self.descend_into([x], 0, own, |tape, d_y, [d_x], _| {
            d_x.copy_from_slice(d_y);
            turn(&tape.values[range], &tape.values[results], d_x);
        });
    }

    /// Has `turn` make slopes by a row of `x` of those by a row of the results, from that row.
    pub(super) fn through_rows(
        &mut self,
        x: Var,
        own: Range<usize>,
        turn: impl Fn(&[f32], &mut [f32]),
    ) {
        let columns = self.of(x).columns;
        self.through(x, own, |_, y, d_x| {
            let rows = y.chunks_exact(columns).zip(d_x.chunks_exact_mut(columns));
            rows.for_each(|(y, d_x)| turn(y, d_x));
        });
    }

    /// Has `add` add to the slopes by `x`, from indices and the slopes by the results.
    pub(super) fn added(
        &mut self,
        x: Var,
        indices: Indices,
        own: Range<usize>,
        add: impl FnOnce(&[u32], &[f32], &mut [f32]),
    ) {
        let Some((range, store)) = self.slopes_of(x) else { return };
        let (before, rest) = self.slopes.split_at_mut(own.start);
        let d_x = &mut before[range];
        if store == Store::Replace {
            d_x.fill(0.0);
        }
        add(&self.indices[indices.0..indices.1], &rest[..own.len()], d_x);
    }
}

/// The first so many numbers of a buffer that only grows.
pub(super) fn sized(buffer: &mut Vec<f32>, numbers: usize) -> &mut [f32] {
    if buffer.len() < numbers {
        buffer.resize(numbers, 0.0);
    }
    &mut buffer[..numbers]
}
