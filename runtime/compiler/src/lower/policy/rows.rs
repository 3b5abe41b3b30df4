//! What becomes of rows: softmax and reductions.

use sortie_core::internal::ops::{
    Choice, Combination, Flag, Function, LookUp, Multiply, Normalise, Op, Place, Reduce, Reduction,
    Select, Softmax,
};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{CumSum, Topk};
use tract_onnx::tract_core::ops::nn::{self, Reducer, SoftmaxKind};

use super::arrange::strides;
use super::pictures::Picture;
use super::values::{Value, numbers};
use super::{Dimension, Lowered, Lowering};

impl Lowering<'_> {
    pub(super) fn softmax(&mut self, node: &TypedNode, op: &nn::Softmax) -> Lowered<()> {
        let place = self.shares(node, op, op.kind == SoftmaxKind::LogSoftmax)?;
        self.give(node, 0, place)
    }

    /// The softmax of a node's rows, or its logarithm.
    fn shares(&mut self, node: &TypedNode, op: &nn::Softmax, logarithm: bool) -> Lowered<Place> {
        let value = self.operand(node, 0)?;
        let (order, columns) = rows(&value.shape, &op.axes);
        let from = self.permuted(node, &value, &order)?;
        let to = self.arena.place(from.len as usize);
        let (logarithm, columns) = (Flag::from(logarithm), columns as u32);
        self.ops.push(Op::Softmax(Softmax { logarithm, columns, from, to }));
        self.restored(node, to, &value.shape, &order)
    }

    /// The logarithm of the numbers that a softmax gives: taken of its rows, as a softmax ends at e⁻⁸⁷; of what 32 bits
    /// hold as nothing it is minus infinity.
    pub(super) fn logarithm_of_shares(
        &mut self,
        softmax: &TypedNode,
        op: &nn::Softmax,
    ) -> Lowered<Place> {
        /// The logarithm of half of the smallest number above zero.
        const LEAST: f32 = -103.972_08;
        let logarithms = self.shares(softmax, op, true)?;
        let [least, none] = [LEAST, f32::NEG_INFINITY].map(|number| self.stored(&[number]));
        let is_nothing = self.combine(Combination::Less, logarithms, least);
        Ok(self.chosen(is_nothing, Some(none), logarithms))
    }

    pub(super) fn reduce(&mut self, node: &TypedNode, op: &nn::Reduce) -> Lowered<()> {
        if op.reducer == Reducer::Prod {
            let value = self.operand(node, 0)?;
            let place = self.product_of_rows(node, &value, &op.axes)?;
            return self.give(node, 0, place);
        }
        let (order, columns) = rows(&self.input_shape(node)?, &op.axes);
        let from = self.reordered(node, 0, &order)?;
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
        let (outlet, shape) = (self.outlet(node, 0)?, self.input_shape(node)?);
        let (order, columns) = rows(&shape, &[norm.axis]);
        let from = self.reordered(node, 0, &order)?;
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
        // Rows that are the points of a picture stay those of one.
        if let Some(picture) = self.values.picture(outlet).filter(|all| all.place == from) {
            self.values.insert_picture((node.id, 0).into(), Picture { place: to, ..picture });
            return Ok(());
        }
        let place = self.restored(node, to, &shape, &order)?;
        self.give(node, 0, place)
    }

    fn input_shape(&self, node: &TypedNode) -> Lowered<Vec<usize>> {
        let outlet = self.outlet(node, 0)?;
        self.shape(self.model.node(outlet.node), outlet.slot)
    }

    pub(super) fn reduced(&mut self, reduction: Reduction, columns: usize, from: Place) -> Place {
        let to = self.arena.place(from.len as usize / columns.max(1));
        self.ops.push(Op::Reduce(Reduce { reduction, columns: columns as u32, from, to }));
        to
    }

    /// Rows whose axes were put behind each other, in the order of the value's own shape.
    fn restored(
        &mut self,
        node: &TypedNode,
        place: Place,
        shape: &[usize],
        order: &[usize],
    ) -> Lowered<Place> {
        if order.is_sorted() {
            return Ok(place);
        }
        let sizes: Vec<usize> = order.iter().map(|axis| shape[*axis]).collect();
        let (from, own) = (strides(&sizes), strides(shape));
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

/// The most numbers that are taken of a row one after the other.
const MOST: usize = 16;

impl Lowering<'_> {
    /// The largest numbers of every row and their places, the largest first: each is closed before the next is looked for.
    pub(super) fn largest_of_rows(&mut self, node: &TypedNode, top: &Topk) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let shape = self.shape(node, 0)?;
        let count = shape[top.axis];
        if count > MOST {
            return Err(self.unsupported(node, "plans take at most 16 numbers of a row"));
        }
        let (order, columns) = rows(&value.shape, &[top.axis]);
        let mut open = self.permuted(node, &value, &order)?;
        if !top.largest {
            open = self.map(Function::Affine, [-1.0, 0.0], open);
        }
        let lines = open.len as usize / columns.max(1);
        let [numbers, places] = [0, 1].map(|_| self.arena.place(lines * count));
        for index in 0..count {
            let largest = self.reduced(Reduction::Maximum, columns, open);
            let place = self.reduced(Reduction::ArgMax, columns, open);
            for (from, all) in [(largest, numbers), (place, places)] {
                let to = Place { offset: all.offset + index as u32, len: all.len - index as u32 };
                self.arrange(node, from, to, &[Dimension { size: lines, from: 1, to: count }])?;
            }
            if index + 1 < count {
                let chosen = self.hot(node, place, columns)?;
                open = self.chosen(chosen, None, open);
            }
        }
        let mut outputs = [numbers, places];
        if !top.largest {
            outputs[0] = self.map(Function::Affine, [-1.0, 0.0], numbers);
        }
        for (slot, place) in outputs.into_iter().enumerate().take(node.outputs.len()) {
            let sizes: Vec<usize> = order.iter().map(|axis| shape[*axis]).collect();
            let mut back = vec![0; order.len()];
            order.iter().enumerate().for_each(|(at, axis)| back[*axis] = at);
            let place = self.permuted(node, &Value { place, shape: sizes }, &back)?;
            self.give(node, slot, place)?;
        }
        Ok(())
    }

    /// Where a condition holds one value, else the other; none is the lowest number there is.
    fn chosen(&mut self, condition: Place, yes: Option<Place>, no: Place) -> Place {
        let yes = yes.unwrap_or_else(|| self.stored(&[f32::MIN]));
        let to = self.arena.place(condition.len as usize);
        self.ops.push(Op::Select(Select { condition, yes, no, to }));
        to
    }

    /// Sums of a row up to each of its numbers: products with a triangle of ones.
    pub(super) fn running_sum(&mut self, node: &TypedNode, sum: &CumSum) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let (order, columns) = rows(&value.shape, &[sum.axis]);
        let left = self.permuted(node, &value, &order)?;
        let counts = |from: usize, to: usize| {
            let (before, after) = if sum.reverse { (to, from) } else { (from, to) };
            before < after || before == after && !sum.exclusive
        };
        let places = (0..columns * columns).map(|at| (at / columns, at % columns));
        let ones: Vec<f32> =
            places.map(|(from, to)| f32::from(u8::from(counts(from, to)))).collect();
        let right = self.stored(&ones);
        let to = self.arena.place(left.len as usize);
        let [rows, inner] = [left.len as usize / columns.max(1), columns].map(|n| n as u32);
        self.ops.push(Op::Multiply(Multiply { rows, inner, columns: inner, left, right, to }));
        let place = self.restored(node, to, &value.shape, &order)?;
        self.give(node, 0, place)
    }

    /// The product of every row.
    fn product_of_rows(
        &mut self,
        node: &TypedNode,
        value: &Value,
        axes: &[usize],
    ) -> Lowered<Place> {
        let (order, columns) = rows(&value.shape, axes);
        if columns > MOST {
            return Err(self.unsupported(node, "plans have products of at most 16 numbers"));
        }
        let others = order.len() - axes.len();
        let turned: Vec<usize> = order[others..].iter().chain(&order[..others]).copied().collect();
        let all = self.permuted(node, value, &turned)?;
        let lines = all.len / columns.max(1) as u32;
        let line = |index: usize| Place { offset: all.offset + index as u32 * lines, len: lines };
        let product = (1..columns).fold(line(0), |product, index| {
            self.combine(Combination::Multiply, product, line(index))
        });
        Ok(product)
    }

    /// Numbers of a row, each where a computed place says.
    pub(super) fn picked(&mut self, node: &TypedNode, axis: usize) -> Lowered<()> {
        let (value, places) = (self.operand(node, 0)?, self.operand(node, 1)?);
        let is_apart = |at: usize| at == axis || value.shape[at] == places.shape[at];
        if value.shape.len() != places.shape.len() || !(0..value.shape.len()).all(is_apart) {
            return Err(self.unsupported(node, "it takes numbers of some rows only"));
        }
        let (order, columns) = rows(&value.shape, &[axis]);
        let rows_of = self.permuted(node, &value, &order)?;
        let asked = self.permuted(node, &places, &order)?;
        let place = self.picked_of_rows(rows_of, asked, columns);
        let place = self.restored(node, place, &places.shape, &order)?;
        self.give(node, 0, place)
    }

    /// The same for rows behind each other, as many numbers of each.
    fn picked_of_rows(&mut self, tables: Place, indices: Place, rows: usize) -> Place {
        let to = self.arena.place(indices.len as usize);
        let (choice, constant, rows, columns) = (Choice::Any, Flag::No, rows as u32, 1);
        self.ops.push(Op::LookUp(LookUp { choice, constant, tables, rows, columns, indices, to }));
        to
    }

    /// Rows that are added to those of a value, each where a computed place says: products with columns of zeros and a one.
    pub(super) fn added_to_rows(&mut self, node: &TypedNode) -> Lowered<()> {
        let (value, places) = (self.operand(node, 0)?, self.operand(node, 1)?);
        let updates = self.operand(node, 2)?.place;
        let (Some(rows), Some(1)) = (value.shape.first(), places.shape.last()) else {
            return Err(self.unsupported(node, "plans add whole rows along the first axis"));
        };
        let (rows, count) = (*rows, places.place.len as usize);
        let hot = self.hot(node, places.place, rows)?;
        let hot = Value { place: hot, shape: vec![count, rows] };
        let left = self.permuted(node, &hot, &[1, 0])?;
        let to = self.arena.place(value.place.len as usize);
        let columns = value.place.len as usize / rows.max(1);
        let [rows, inner, columns] = [rows, count, columns].map(|n| n as u32);
        self.ops.push(Op::Multiply(Multiply { rows, inner, columns, left, right: updates, to }));
        let place = self.combine(Combination::Add, value.place, to);
        self.give(node, 0, place)
    }

    /// Numbers of the last axis, one of every row, or whole rows, where a computed place says.
    pub(super) fn picked_behind(&mut self, node: &TypedNode, batch: usize) -> Lowered<()> {
        let (value, places) = (self.operand(node, 0)?, self.operand(node, 1)?);
        let (before, last) = value.shape.split_at(batch);
        let is_one_table = before.iter().all(|size| *size == 1);
        if is_one_table && last.len() > 1 && places.shape.last() == Some(&1) {
            return self.looked_up(node, batch);
        }
        let is_row = places.shape.starts_with(before)
            && places.shape[batch..].iter().product::<usize>() == 1;
        let &[columns] = last else {
            return Err(self.unsupported(node, "which parts it takes is computed"));
        };
        if !is_row {
            return Err(self.unsupported(node, "which parts it takes is computed"));
        }
        let place = self.picked_of_rows(value.place, places.place, columns);
        self.give(node, 0, place)
    }
}
