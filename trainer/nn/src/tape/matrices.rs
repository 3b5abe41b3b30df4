//! Parameters as matrices and their products; functions of single numbers; attention of teams and with absorbed keys.
//!
//! Matrices that stand behind each other without anything between them are one, whose parameters are a product:
//! see [`product`](Pass::product).

use std::ops::Range;

use super::{Attended, Linear, Operation, Pass, Tape, Var};
use crate::layers::absorbed_attention::AbsorbedBackward;
use crate::layers::attention::AttentionShape;
use crate::layers::elementwise::{self, Activation};
use crate::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use crate::layers::normalise;
use crate::layers::team_attention::{self, Sums};
use crate::layers::{TeamLists, VisibleLists};

impl Pass<'_> {
    /// Some parameters as a matrix, from where they begin.
    pub fn parameter(&mut self, start: usize, [rows, columns]: [usize; 2]) -> Var {
        let y = self.tape.push(Operation::Parameter { start }, rows, columns, true);
        let own = &self.parameters[start..start + rows * columns];
        self.tape.split([], y).1.copy_from_slice(own);
        y
    }

    /// `a b`, of matrices `[n, k]` and `[k, m]`.
    pub fn product(&mut self, a: Var, b: Var) -> Var {
        self.product_of(a, b, false)
    }

    /// `a b'`, of matrices `[n, k]` and `[m, k]`: a linear layer whose weight was computed.
    pub fn product_transposed(&mut self, a: Var, b: Var) -> Var {
        self.product_of(a, b, true)
    }

    fn product_of(&mut self, a: Var, b: Var, transposed: bool) -> Var {
        let ([rows, inner], size) = (self.size(a), self.size(b));
        let [own_inner, columns] = if transposed { [size[1], size[0]] } else { size };
        assert_eq!(inner, own_inner, "inner dimension of the product");
        let operation = Operation::Product { a, b, transposed };
        self.join(operation, [a, b], [rows, columns], |a, b, y| {
            let out = MatrixMut::new(y, rows, columns);
            multiply(out, Store::Replace, Matrix::new(a, rows, inner), turned(b, size, transposed));
        })
    }

    /// The absolute value of every number.
    pub fn abs(&mut self, x: Var) -> Var {
        let size = self.size(x);
        self.step(Operation::Absolute { x }, x, size, elementwise::absolute)
    }

    /// Every row so scaled that the mean of its squares is 1.
    pub fn normalise_rows(&mut self, x: Var) -> Var {
        let size = self.size(x);
        self.step(Operation::NormaliseRows { x }, x, size, |x, y| normalise::rows(size[1], x, y))
    }

    /// `x` where it is positive, else `exp(x) - 1`.
    pub fn elu(&mut self, x: Var) -> Var {
        self.activate(x, Activation::Elu)
    }

    /// `exp(x)`
    pub fn exp(&mut self, x: Var) -> Var {
        self.activate(x, Activation::Exp)
    }

    /// The square root, whose slope at 0 is infinite.
    pub fn root(&mut self, x: Var) -> Var {
        self.activate(x, Activation::Root)
    }

    /// The nearest number between two bounds, at which there is no slope.
    pub fn clamp(&mut self, x: Var, least: f32, most: f32) -> Var {
        self.activate(x, Activation::Clamp(least, most))
    }

    /// `x + number`
    pub fn offset(&mut self, x: Var, number: f32) -> Var {
        let size = self.size(x);
        self.step(Operation::Scale { x, factor: 1.0 }, x, size, |x, y| {
            y.iter_mut().zip(x).for_each(|(y, x)| *y = x + number);
        })
    }

    /// The sum of all numbers, each times its weight: a loss with these slopes.
    pub fn weighted_sum(&mut self, x: Var, weights: &[f32]) -> Var {
        let row = self.reshape(x, weights.len());
        let weights = self.input(weights.len(), weights);
        let terms = self.multiply(row, weights);
        self.sum_columns(terms)
    }

    /// As [`attention`](Self::attention), where the queries absorb the matrix of keys and values `[2 width, width]`:
    /// fewer products where entities are seen by few queries each.
    pub fn absorbed_attention(
        &mut self,
        queries: Var,
        entities: Var,
        keys_values: Linear,
        visible: &VisibleLists,
        heads: usize,
    ) -> Var {
        let [count, width] = self.size(queries);
        assert_eq!((count, width), (visible.queries(), self.size(entities)[1]), "sizes");
        let (lists, inputs) = (self.tape.keep_lists(visible), [queries, entities]);
        let (pass, _) = self.tape.absorbed.next();
        let pairs = visible.pairs();
        let operation = Operation::Absorb { inputs, keys_values, lists, pairs, pass, heads };
        let y = self.tape.push(operation, count, width, true);
        let ranges = inputs.map(|var| self.tape.of(var).range());
        let out = self.tape.of(y).range();
        let (before, rest) = self.tape.values.split_at_mut(out.start);
        let [queries, entities] = ranges.map(|range| &before[range]);
        self.tape.absorbed.things[pass].forward(
            AttentionShape { width, heads },
            visible,
            &self.parameters[keys_values.weight_range()],
            (queries, entities),
            &mut rest[..out.len()],
        );
        y
    }

    /// What teams of queries make of the rows that all of a team see: `[sums, heads * width]`, for each head the
    /// sum of the rows themselves. Queries, keys and rows are `[.., width]`.
    pub fn team_attention(
        &mut self,
        inputs: [Var; 3],
        teams: &TeamLists,
        sums: Sums,
        heads: usize,
    ) -> Var {
        let [[count, width], keys, rows] = inputs.map(|var| self.size(var));
        assert_eq!((count, keys), (teams.queries(), rows), "sizes");
        let (lists, kept) = self.tape.teams.next();
        kept.copy_from(teams);
        let size = [sums.count(teams), heads * width];
        let operation = |weights| Operation::AttendInTeams { inputs, lists, weights, heads, sums };
        self.keep(teams.pairs() * heads, operation, inputs, size, |inputs, weights, out| {
            let [queries, keys, rows] = inputs;
            let pass = team_attention::Forward { queries, keys, rows, weights, sums: out };
            team_attention::forward(AttentionShape { width, heads }, teams, sums, pass);
        })
    }

    /// Floating-point operations of this pass up to now, those of products and attention; with those of its way
    /// back where it `went_back`.
    pub fn operations(&self, went_back: bool) -> u64 {
        let of = |node: &super::Node| {
            let (multiplications, gradients) = self.tape.multiplications(node);
            2 * multiplications * if went_back { 1 + gradients } else { 1 }
        };
        self.tape.nodes.iter().map(of).sum::<usize>() as u64
    }
}

/// A matrix `[rows, columns]`, transposed or as it is.
fn turned(numbers: &[f32], [rows, columns]: [usize; 2], transposed: bool) -> Matrix<'_> {
    let matrix = Matrix::new(numbers, rows, columns);
    if transposed { matrix.transposed() } else { matrix }
}

impl Tape {
    /// Multiplications of a step, and how many gradients its way back takes as many for.
    fn multiplications(&self, node: &super::Node) -> (usize, usize) {
        let super::Node { rows, columns, .. } = *node;
        let count = match node.operation {
            Operation::Linear { layer, .. } => rows * columns * layer.shape.input,
            Operation::LinearSum { layers, .. } => {
                rows * columns * layers.iter().map(|layer| layer.shape.input).sum::<usize>()
            }
            Operation::SparseLinear { entries, .. } => return (entries * columns, 1),
            Operation::Product { a, .. } => rows * columns * self.of(a).columns,
            Operation::Attend { pairs, to: Attended::Whole, .. } => 2 * pairs * columns,
            Operation::Absorb { pairs, heads, .. } => {
                2 * (rows * columns + pairs * heads) * columns
            }
            Operation::AttendInTeams { lists, heads, sums, .. } => {
                let teams = &self.teams.things[lists];
                let summed = if sums == Sums::PerQuery { teams.pairs() } else { teams.members() };
                (teams.pairs() / heads + summed) * columns
            }
            Operation::Recur { .. } => 6 * rows * columns * columns,
            _ => 0,
        };
        (count, 2)
    }

    pub(super) fn descend_product(&mut self, a: Var, b: Var, transposed: bool, own: Range<usize>) {
        let [(a_range, a_size), (b_range, b_size)] =
            [a, b].map(|var| (self.of(var).range(), [self.of(var).rows, self.of(var).columns]));
        let columns = if transposed { b_size[0] } else { b_size[1] };
        self.from(a, own.clone(), |store, values, _, d_y, d_a| {
            let d_y = Matrix::new(d_y, a_size[0], columns);
            let b = turned(&values[b_range], b_size, !transposed);
            multiply(MatrixMut::new(d_a, a_size[0], a_size[1]), store, d_y, b);
        });
        self.from(b, own, |store, values, _, d_y, d_b| {
            let d_y = Matrix::new(d_y, a_size[0], columns);
            let a = Matrix::new(&values[a_range], a_size[0], a_size[1]);
            let d_b = MatrixMut::new(d_b, b_size[0], b_size[1]);
            if transposed {
                multiply(d_b, store, d_y.transposed(), a);
            } else {
                multiply(d_b, store, a.transposed(), d_y);
            }
        });
    }

    pub(super) fn descend_absorbed(
        &mut self,
        inputs: [Var; 2],
        (keys_values, d_keys_values): (&[f32], &mut [f32]),
        [lists, pass, heads]: [usize; 3],
        own: Range<usize>,
    ) {
        let shape = AttentionShape { width: self.of(inputs[0]).columns, heads };
        let ranges = inputs.map(|var| self.of(var).range());
        self.descend_into(inputs, 0, own, |tape, d_output, [d_queries, d_entities], _| {
            let [queries, entities] = ranges.map(|range| &tape.values[range]);
            let slopes = AbsorbedBackward {
                queries,
                entities,
                d_output,
                d_queries,
                d_entities,
                d_keys_values,
            };
            let visible = &tape.lists.things[lists];
            tape.absorbed.things[pass].backward(shape, visible, keys_values, slopes);
        });
    }

    pub(super) fn descend_teams(
        &mut self,
        inputs: [Var; 3],
        [lists, weights, heads]: [usize; 3],
        sums: Sums,
        own: Range<usize>,
    ) {
        let shape = AttentionShape { width: self.of(inputs[0]).columns, heads };
        let ranges = inputs.map(|var| self.of(var).range());
        self.descend_into(inputs, 0, own, |tape, d_sums, [d_queries, d_keys, d_rows], _| {
            let teams = &tape.teams.things[lists];
            // Queries of teams that see nothing are not written.
            d_queries.fill(0.0);
            let [queries, keys, rows] = ranges.map(|range| &tape.values[range]);
            let weights = &tape.values[weights..][..teams.pairs() * heads];
            let pass = team_attention::Backward {
                queries,
                keys,
                rows,
                weights,
                d_sums,
                d_queries,
                d_keys,
                d_rows,
            };
            team_attention::backward(shape, teams, sums, pass);
        });
    }
}
