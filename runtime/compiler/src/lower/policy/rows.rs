//! What becomes of rows: softmax and reductions.

use sortie_core::internal::ops::{
    Combination, Flag, Function, Normalise, Op, Place, Reduce, Reduction, Softmax,
};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::nn;
use tract_onnx::tract_core::ops::nn::{Reducer, SoftmaxKind};

use super::arrange::{Dimension, strides};
use super::values::{Value, numbers};
use super::{Lowered, Lowering};

impl Lowering<'_> {
    pub(super) fn softmax(&mut self, node: &TypedNode, op: &nn::Softmax) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let (order, columns) = rows(&value.shape, &op.axes);
        let from = self.permuted(node, &value, &order)?;
        let to = self.arena.place(from.len as usize);
        self.ops.push(Op::Softmax(Softmax {
            logarithm: Flag::from(op.kind == SoftmaxKind::LogSoftmax),
            columns: columns as u32,
            from,
            to,
        }));
        let place = self.restored(node, to, &value, &order)?;
        self.give(node, 0, place)
    }

    pub(super) fn reduce(&mut self, node: &TypedNode, op: &nn::Reduce) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        if op.reducer == Reducer::Prod {
            let place = self.product_of_rows(node, &value, &op.axes)?;
            return self.give(node, 0, place);
        }
        let (order, columns) = rows(&value.shape, &op.axes);
        let from = self.permuted(node, &value, &order)?;
        let place = match op.reducer {
            Reducer::Sum => self.reduced(Reduction::Sum, columns, from),
            Reducer::Max => self.reduced(Reduction::Maximum, columns, from),
            Reducer::Min => self.reduced(Reduction::Minimum, columns, from),
            Reducer::ArgMax(false) => self.reduced(Reduction::ArgMax, columns, from),
            Reducer::ArgMin(false) => {
                let negated = self.map(Function::Affine, [-1.0, 0.0], from);
                self.reduced(Reduction::ArgMax, columns, negated)
            }
            Reducer::MeanOfSquares => {
                let squares = self.combine(Combination::Multiply, from, from);
                self.reduced(Reduction::Mean, columns, squares)
            }
            Reducer::All => self.reduced(Reduction::Minimum, columns, from),
            Reducer::Any => self.reduced(Reduction::Maximum, columns, from),
            _ => return Err(self.unsupported(node, "plans do not reduce rows in this way")),
        };
        self.give(node, 0, place)
    }

    /// Divides rows by the root of the mean of their squares; what layer normalisation does besides are nodes of their own.
    pub(super) fn normalise(&mut self, node: &TypedNode, norm: &nn::RmsNorm) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let (order, columns) = rows(&value.shape, &[norm.axis]);
        let from = self.permuted(node, &value, &order)?;
        let epsilon = numbers(&norm.eps).and_then(|epsilon| epsilon.first().copied());
        let epsilon = epsilon.ok_or_else(|| self.unsupported(node, "it lacks its epsilon"))?;
        let to = self.arena.place(from.len as usize);
        self.ops.push(Op::Normalise(Normalise {
            centred: Flag::No,
            columns: columns as u32,
            epsilon: epsilon.to_bits(),
            factors: self.weights.add_numbers(&vec![1.0; columns]),
            offsets: self.weights.add_numbers(&vec![0.0; columns]),
            from,
            to,
        }));
        let place = self.restored(node, to, &value, &order)?;
        self.give(node, 0, place)
    }

    pub(super) fn reduced(&mut self, reduction: Reduction, columns: usize, from: Place) -> Place {
        let to = self.arena.place(from.len as usize / columns.max(1));
        self.ops.push(Op::Reduce(Reduce { reduction, columns: columns as u32, from, to }));
        to
    }

    /// Rows whose axes were put behind each other, in the value's own order.
    pub(super) fn restored(
        &mut self,
        node: &TypedNode,
        place: Place,
        value: &Value,
        order: &[usize],
    ) -> Lowered<Place> {
        if order.is_sorted() {
            return Ok(place);
        }
        let sizes: Vec<usize> = order.iter().map(|axis| value.shape[*axis]).collect();
        let (from, own) = (strides(&sizes), strides(&value.shape));
        let dimensions: Vec<Dimension> = (order.iter().zip(&from).zip(&sizes))
            .map(|((axis, from), size)| Dimension { size: *size, from: *from, to: own[*axis] })
            .collect();
        let to = self.arena.place(place.len as usize);
        self.arrange(node, place, to, &dimensions)?;
        Ok(to)
    }
}

/// The axes with those of a row last, and the numbers of a row.
pub(super) fn rows(shape: &[usize], axes: &[usize]) -> (Vec<usize>, usize) {
    let is_column = |axis: &usize| axes.contains(axis);
    let others = (0..shape.len()).filter(|axis| !is_column(axis));
    let order: Vec<usize> = others.chain((0..shape.len()).filter(is_column)).collect();
    let columns = axes.iter().filter_map(|axis| shape.get(*axis)).product();
    (order, columns)
}
