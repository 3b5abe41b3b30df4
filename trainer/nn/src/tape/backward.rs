//! The way back: from the slope of the loss to those of all parameters, step by step.

use std::ops::Range;

use super::{Gru, Indices, Linear, Operation, Pass, Tape, Var};
use crate::layers::attention::AttentionShape;
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
                    elementwise::rectify_backward(
                        &self.values[own.clone()],
                        &mut self.slopes[own.clone()],
                    );
                }
                self.descend_linear(x, layer, own, parameters, gradient);
            }
            Operation::LinearSum { x, layers } => {
                elementwise::rectify_backward(
                    &self.values[own.clone()],
                    &mut self.slopes[own.clone()],
                );
                for (x, layer) in x.into_iter().zip(layers) {
                    self.descend_linear(x, layer, own.clone(), parameters, gradient);
                }
            }
            Operation::SparseLinear { rows, layer, rectified } => {
                if rectified {
                    elementwise::rectify_backward(
                        &self.values[own.clone()],
                        &mut self.slopes[own.clone()],
                    );
                }
                let [weight, bias] = weight_and_bias(layer, gradient);
                let rows = &self.sparse.things[rows as usize];
                sparse_linear::backward(rows, &self.slopes[own], weight, bias);
            }
            Operation::Activate { x, activation } => self.from(x, own, |store, _, y, d_y, d_x| {
                elementwise::activate_backward(activation, y, d_y, store, d_x);
            }),
            Operation::Softmax { x } => self.through_rows(x, own, softmax::backward),
            Operation::LogSoftmax { x } => self.through_rows(x, own, softmax::log_backward),
            Operation::Attend { inputs, lists, weights, shape, parts } => {
                let places = [lists, weights].map(|place| place as usize);
                self.descend_attention(inputs, places, shape, parts, own);
            }
            Operation::SquaredScores { inputs, lists, scores, shape } => {
                let places = [lists, scores].map(|place| place as usize);
                self.descend_scores(inputs, places, shape, own);
            }
            Operation::Recur { x, pass, carry, slots, layer } => {
                let places = [pass, carry, slots].map(|place| place as usize);
                self.descend_gru(x, places, layer, own, parameters, gradient);
            }
            Operation::Unfold { x, shape } => {
                self.added(x, (0, 0), own, |_, d_y, d_x| unfold::backward(shape, d_y, d_x));
            }
            Operation::Gather { x, indices } => {
                let columns = self.columns(x);
                self.added(x, indices, own, |rows, d_y, d_x| {
                    for (row, d_y) in rows.iter().zip(d_y.chunks_exact(columns)) {
                        let d_x = &mut d_x[*row as usize * columns..][..columns];
                        elementwise::scale(1.0, d_y, Store::Add, d_x);
                    }
                });
            }
            Operation::Scatter { x, indices } => {
                let columns = self.columns(x);
                self.added(x, indices, own, |rows, d_y, d_x| {
                    for (row, d_x) in rows.iter().zip(d_x.chunks_exact_mut(columns)) {
                        let d_y = &d_y[*row as usize * columns..][..columns];
                        elementwise::scale(1.0, d_y, Store::Add, d_x);
                    }
                });
            }
            Operation::Pick { x, indices } => {
                let width = self.columns(x);
                self.added(x, indices, own, |columns, d_y, d_x| {
                    let rows = d_x.chunks_exact_mut(width).zip(d_y);
                    for ((d_x, d_y), column) in rows.zip(columns) {
                        d_x[*column as usize] += d_y;
                    }
                });
            }
            Operation::Columns { x, first } => {
                let (rows, width) = (self.rows(x), self.columns(x));
                self.added(x, (0, 0), own, |_, d_y, d_x| {
                    let columns = d_y.len() / rows.max(1);
                    let slopes = d_x.chunks_exact_mut(width).zip(d_y.chunks_exact(columns));
                    for (d_x, d_y) in slopes {
                        let d_x = &mut d_x[first as usize..][..columns];
                        elementwise::scale(1.0, d_y, Store::Add, d_x);
                    }
                });
            }
            Operation::Concat { parts } => self.descend_concat(parts, own),
            Operation::SumColumns { x } => {
                let width = self.columns(x);
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
                let columns = self.columns(advantages);
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
                    elementwise::squared_error_slope(x - target, factor * d_y)
                });
            }
            Operation::Huber { x, target, factor, bound } => {
                self.descend_loss(x, target, own, |x, target, d_y| {
                    elementwise::huber_slope(x - target, factor * d_y, bound)
                });
            }
            Operation::SoftmaxGroups { x, indices, groups } => {
                self.descend_softmax_groups(x, indices, groups as usize, own);
            }
            Operation::Parameter { start } => {
                let place = start as usize..start as usize + own.len();
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
                let (range, columns) = (self.of(x).range(), self.columns(x));
                self.from(x, own, |store, values, y, d_y, d_x| {
                    let known = [&values[range], y, d_y];
                    normalise::rows_backward(columns, known, store, d_x);
                });
            }
            Operation::Absorb { inputs, keys_values, lists, pass, heads } => {
                let places = [lists, pass, heads].map(|place| place as usize);
                let weight = keys_values.weight_range();
                let matrix = (&parameters[weight.clone()], &mut gradient[weight]);
                self.descend_absorbed(inputs, matrix, places, own);
            }
            Operation::AttendInTeams { inputs, lists, weights, heads, sums } => {
                let places = [lists, weights, heads].map(|place| place as usize);
                self.descend_teams(inputs, places, sums, own);
            }
        }
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
            let part = Var(self.indices[part as usize]);
            let (rows, columns) = (self.rows(part), self.columns(part));
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
        let columns = self.columns(x);
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
        [lists, weights]: [usize; 2],
        shape: AttentionShape,
        parts: bool,
        own: Range<usize>,
    ) {
        let (ranges, results) = (inputs.map(|var| self.of(var).range()), own.clone());
        let pairs = self.lists.things[lists].pairs() * shape.heads;
        self.descend_into(inputs, pairs, own, |tape, d_output, d_inputs, d_scores| {
            let (visible, values) = (&tape.lists.things[lists], &tape.values);
            let [queries, keys_values] = ranges.map(|range| &values[range]);
            let [d_queries, d_keys_values] = d_inputs;
            let (of_pairs, behind) = values[weights..].split_at(pairs);
            if parts || split_attention::is_built_for(shape.width, shape.heads) {
                let pass = split_attention::Backward {
                    queries,
                    keys_values,
                    weights: of_pairs,
                    shares: behind,
                    output: &values[results],
                    d_output,
                    d_scores,
                    d_queries,
                    d_keys_values,
                };
                split_attention::backward(shape.width, visible, pass);
            } else {
                let pass = attention::Backward {
                    queries,
                    keys_values,
                    of_pairs,
                    d_output,
                    d_scores,
                    d_queries,
                    d_keys_values,
                };
                attention::backward(shape, visible, pass);
            }
        });
    }

    /// Through the squared scores of queries and keys.
    fn descend_scores(
        &mut self,
        inputs: [Var; 2],
        [lists, scores]: [usize; 2],
        shape: AttentionShape,
        own: Range<usize>,
    ) {
        let ranges = inputs.map(|var| self.of(var).range());
        let pairs = self.lists.things[lists].pairs() * shape.heads;
        self.descend_into(inputs, pairs, own, |tape, d_output, d_inputs, d_scores| {
            let [queries, keys_values] = ranges.map(|range| &tape.values[range]);
            let [d_queries, d_keys_values] = d_inputs;
            let pass = attention::Backward {
                queries,
                keys_values,
                of_pairs: &tape.values[scores..][..pairs],
                d_output,
                d_scores,
                d_queries,
                d_keys_values,
            };
            attention::squared_scores_backward(shape, &tape.lists.things[lists], pass);
        });
    }
}

/// The gradients of weight and bias of a layer that has both.
fn weight_and_bias(layer: Linear, gradient: &mut [f32]) -> [&mut [f32]; 2] {
    let bias = layer.bias_range().expect("sparse layers have offsets");
    gradient.get_disjoint_mut([layer.weight_range(), bias]).expect("tensors beside each other")
}
