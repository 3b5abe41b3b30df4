//! Products: layers where one side is constant, and those of two values.

use sortie_bundle::sha256;
use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{Choice, Flag, GruCell, LookUp, LstmCell, Multiply, Op, Place};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::OneHot;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_core::ops::einsum::EinSum;

use super::arrange::strides;
use super::pictures::Picture;
use super::values::{PolicyWeights, StoredLayer, Value, numbers};
use super::{Dimension, Lowered, Lowering, WIDEST};
use crate::lower::agent::at_most;
use crate::matching::{Layer, Matrix, as_matrix};

/// Rows that fill the registers of a processor: so many are worked on as patches.
const MANY_ROWS: usize = 12;

/// Which side of a product has an axis that is longer than one.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Both, and the result: one product for each.
    Each,
    /// The left one and the result.
    Row,
    /// Both, and they are summed over.
    Inner,
    /// The right one and the result.
    Column,
}

/// An axis of a product: where it stands in both operands and in the result.
struct Axis {
    kind: Kind,
    size: usize,
    at: [Option<usize>; 2],
    out: Option<usize>,
}

/// A vector of zeros and a one: the number that says where it stands, and which places it may say.
struct Hot {
    index: OutletId,
    choice: Choice,
}

impl<'m> Lowering<'m> {
    pub(super) fn product(&mut self, node: &TypedNode, einsum: &EinSum) -> Lowered<()> {
        for slot in [1, 0] {
            let constant = self.constant(self.outlet(node, slot)?);
            let constant = constant.filter(|tensor| tensor.datum_type() == f32::datum_type());
            let matrix = constant.and_then(|tensor| as_matrix(einsum, &tensor, slot));
            if let (Some(matrix), 2) = (matrix, node.inputs.len()) {
                let bias = vec![0.0; matrix.outputs];
                let layer = Layer { matrix, bias, relu: false };
                return self.layer(node, einsum, 1 - slot, layer);
            }
        }
        self.product_of_two(node, einsum)
    }

    /// The same layer for every row of a value.
    fn layer(
        &mut self,
        node: &TypedNode,
        einsum: &EinSum,
        slot: usize,
        mut layer: Layer,
    ) -> Lowered<()> {
        let is_tiled = matches!(self.weights, PolicyWeights::Tiles(_));
        if let Some(hot) = self.hot_vector(node, slot).filter(|_| is_tiled) {
            return self.row_of_layer(node, hot, layer);
        }
        let outlet = self.outlet(node, slot)?;
        let shape = self.shape(self.model.node(outlet.node), outlet.slot)?;
        let axes = self.product_axes(node, einsum)?;
        let own = |axis: &Axis| axis.at[slot];
        let is_inner = |axis: &&Axis| axis.kind == Kind::Inner;
        let rows: Vec<&Axis> =
            axes.iter().filter(|axis| own(axis).is_some() && !is_inner(axis)).collect();
        let mut order: Vec<usize> = rows.iter().filter_map(|axis| own(axis)).collect();
        order.sort_unstable();
        let mut inner: Vec<usize> = axes.iter().filter(is_inner).filter_map(own).collect();
        inner.sort_unstable();
        order.extend(inner);
        // Axes of one number stand anywhere.
        let others = (0..shape.len()).filter(|axis| !order.contains(axis));
        let order: Vec<usize> = others.collect::<Vec<_>>().into_iter().chain(order).collect();
        let whole = self.values.picture(outlet);
        let whole = whole.filter(|all| all.place.len as usize == layer.matrix.inputs);
        let from = if let Some(picture) = whole {
            // All of it is summed over, in whichever order.
            layer.matrix = picture.ordered(&layer.matrix);
            picture.place
        } else {
            self.reordered(node, slot, &order)?
        };
        let (inputs, outputs) = (layer.matrix.inputs, layer.matrix.outputs);
        at_most("the width of a layer", inputs.max(outputs), WIDEST)?;
        let rows = (from.len as usize / inputs.max(1)).max(1);
        let sized: Vec<&Axis> = axes.iter().filter(|axis| axis.out.is_some()).collect();
        let is_row = |axis: &&&Axis| own(axis).is_some();
        let mut behind: Vec<&Axis> = sized.iter().filter(is_row).copied().collect();
        behind.sort_by_key(|axis| own(axis));
        let mut columns: Vec<&Axis> = sized.iter().filter(|axis| !is_row(axis)).copied().collect();
        columns.sort_by_key(|axis| axis.out);
        // The graph has the columns in front: then rows are the points of a picture, and their columns its channels.
        let turned: Vec<_> = columns.iter().chain(&behind).map(|axis| axis.out).collect();
        behind.extend(&columns);
        let is_in_order = rows == 1 || self.is_in_order(node, &behind)?;
        let is_picture = !is_in_order && turned.is_sorted();
        // Where the result needs no other order, bias and ReLU can join the layer.
        let of_columns = |constant: &Tensor| {
            let is_column = |axis: usize| columns.iter().any(|column| column.out == Some(axis));
            let mut sizes = constant.shape().iter().enumerate();
            rows == 1 || sizes.all(|(axis, size)| *size == 1 || is_column(axis))
        };
        let absorbed = if is_in_order || is_picture {
            self.absorb(node, &mut layer, of_columns)
        } else {
            Vec::new()
        };
        let to = if rows < MANY_ROWS {
            let to = self.arena.place((rows - 1) * outputs + padded(outputs));
            let sparse_input = self.relu_behind(node, slot);
            if sparse_input {
                self.longest_sparse = self.longest_sparse.max(inputs);
            }
            let stored = self.stored_layer(&layer, sparse_input);
            self.ops.extend(stored.ops(rows, from, to));
            Place { len: (rows * outputs) as u32, ..to }
        } else {
            self.layer_on_rows(&layer, rows, from)
        };
        if is_in_order {
            self.give(node, 0, to)?;
            return absorbed.into_iter().try_for_each(|node| self.give(node, 0, to));
        }
        if is_picture {
            let picture = Picture { place: to, count: 1, points: rows, channels: outputs };
            for node in [node].into_iter().chain(absorbed) {
                self.values.insert_picture((node.id, 0).into(), picture);
            }
            return Ok(());
        }
        self.result(node, to, &behind)
    }

    /// A layer on zeros and a one: what it makes of each place of the one, and of zeros alone, stands in a table.
    fn row_of_layer(&mut self, node: &TypedNode, hot: Hot, mut layer: Layer) -> Lowered<()> {
        let absorbed = self.absorb(node, &mut layer, |_| true);
        let Layer { matrix, bias, relu } = &layer;
        let zeros = vec![0.0; matrix.outputs];
        let rows = matrix.values.chunks(matrix.outputs.max(1)).chain([zeros.as_slice()]);
        let finished = |sum: f32| if *relu && sum <= 0.0 { 0.0 } else { sum };
        let table: Vec<f32> = rows
            .flat_map(|row| bias.iter().zip(row).map(|(bias, number)| finished(bias + number)))
            .collect();
        let tables = self.stored_table(&table);
        let indices = self.place_of(hot.index)?;
        let to = self.arena.place(padded(matrix.outputs));
        let to = Place { len: matrix.outputs as u32, ..to };
        let (choice, constant, columns) = (hot.choice, Flag::Yes, to.len);
        let rows = matrix.inputs as u32 + 1;
        self.ops.push(Op::LookUp(LookUp { choice, constant, tables, rows, columns, indices, to }));
        self.give(node, 0, to)?;
        absorbed.into_iter().try_for_each(|node| self.give(node, 0, to))
    }

    /// The number that says where a vector of zeros has its one, if that is what an operand is.
    fn hot_vector(&self, node: &TypedNode, slot: usize) -> Option<Hot> {
        let mut node = self.model.node(node.inputs.get(slot)?.node);
        // Zeros and ones are the same numbers in every type.
        while node.op_is::<AxisOp>() || node.op_is::<Cast>() {
            node = self.model.node(node.inputs.first()?.node);
        }
        let is_single = |outlet: &OutletId| {
            let shape =
                self.model.outlet_fact(*outlet).ok().and_then(|fact| fact.shape.as_concrete());
            shape.is_some_and(|shape| shape.iter().all(|size| *size == 1))
        };
        if let Some(hot) = node.op_as::<OneHot>() {
            let is_plain = numbers(&hot.off)? == [0.0] && numbers(&hot.on)? == [1.0];
            let index = *node.inputs.first().filter(|index| is_plain && is_single(index))?;
            return Some(Hot { index, choice: Choice::AnyOrLast });
        }
        node.op_as::<TypedBinOp>().filter(|op| op.0.name() == "Eq")?;
        let counts = |outlet: &OutletId| {
            let numbers = self.constant(*outlet).and_then(|tensor| numbers(&tensor));
            numbers.is_some_and(|all| (0..).zip(all).all(|(place, number)| number == place as f32))
        };
        let &[left, right] = node.inputs.as_slice() else { return None };
        let index = match (counts(&left), counts(&right)) {
            (false, true) => left,
            (true, false) => right,
            _ => return None,
        };
        is_single(&index).then_some(Hot { index, choice: Choice::FirstOrLast })
    }

    /// Adds a layer to the weights; one that stands there already, as in every turn of a loop, stands there once.
    fn stored_layer(&mut self, layer: &Layer, sparse_input: bool) -> StoredLayer {
        let key = key(layer, [usize::from(layer.relu), usize::from(sparse_input)]);
        if let Some(stored) = self.layers.get(&key) {
            return *stored;
        }
        let stored = self.weights.add_layer(layer, sparse_input, &mut self.arena);
        self.layers.insert(key, stored);
        stored
    }

    /// Takes the bias and the ReLU behind a product into its layer, where nothing else reads what is between.
    fn absorb(
        &self,
        node: &TypedNode,
        layer: &mut Layer,
        of_columns: impl Fn(&Tensor) -> bool,
    ) -> Vec<&'m TypedNode> {
        let mut absorbed = Vec::new();
        let outputs = layer.matrix.outputs;
        let sum = self.only_reader(node, "Add").and_then(|(sum, constant)| {
            let constant = self.constant(constant).filter(|constant| of_columns(constant))?;
            Some((sum, bias(&constant, outputs)?))
        });
        let mut last = node;
        if let Some((sum, bias)) = sum {
            layer.bias = bias;
            absorbed.push(sum);
            last = sum;
        }
        if let Some(relu) = self.relu_after(last) {
            layer.relu = true;
            absorbed.push(relu);
        }
        absorbed
    }

    /// The ReLU that alone reads a node.
    pub(super) fn relu_after(&self, node: &TypedNode) -> Option<&'m TypedNode> {
        let (relu, low) = self.only_reader(node, "Max")?;
        (self.uniform(low) == Some(0.0)).then_some(relu)
    }

    /// The function of two that alone reads a node, and its other operand.
    fn only_reader(&self, node: &TypedNode, name: &str) -> Option<(&'m TypedNode, OutletId)> {
        let own = OutletId::new(node.id, 0);
        let readers = &node.outputs.first()?.successors;
        let &[reader] = readers.as_slice() else { return None };
        let reader = self.model.node(reader.node);
        let is_output = self.model.outputs.contains(&own);
        let is_named = reader.op_as::<TypedBinOp>().is_some_and(|op| op.0.name() == name);
        let other = reader.inputs.iter().copied().find(|input| *input != own)?;
        (is_named && !is_output).then_some((reader, other))
    }

    /// Whether a value comes out of a ReLU, so that many of its numbers are zero.
    fn relu_behind(&self, node: &TypedNode, slot: usize) -> bool {
        let Some(outlet) = node.inputs.get(slot) else { return false };
        let mut before = self.model.node(outlet.node);
        while let (true, Some(outlet)) = (before.op_is::<AxisOp>(), before.inputs.first()) {
            before = self.model.node(outlet.node);
        }
        let is_max = before.op_as::<TypedBinOp>().is_some_and(|op| op.0.name() == "Max");
        is_max && before.inputs.iter().any(|input| self.uniform(*input) == Some(0.0))
    }

    fn product_of_two(&mut self, node: &TypedNode, einsum: &EinSum) -> Lowered<()> {
        let values = [self.operand(node, 0)?, self.operand(node, 1)?];
        let axes = self.product_axes(node, einsum)?;
        let of = |kind: Kind| axes.iter().filter(move |axis| axis.kind == kind);
        let size = |kind: Kind| of(kind).map(|axis| axis.size).product::<usize>();
        let behind = |slot: usize, kinds: [Kind; 3], value: &Value| -> Vec<usize> {
            let known = kinds.into_iter().flat_map(of).filter_map(|axis| axis.at[slot]);
            let known: Vec<usize> = known.collect();
            let others = (0..value.shape.len()).filter(|axis| !known.contains(axis));
            others.chain(known.iter().copied()).collect()
        };
        let left_order = behind(0, [Kind::Each, Kind::Row, Kind::Inner], &values[0]);
        let right_order = behind(1, [Kind::Each, Kind::Inner, Kind::Column], &values[1]);
        let left = self.permuted(node, &values[0], &left_order)?;
        let right = self.permuted(node, &values[1], &right_order)?;
        let (rows, inner, columns) = (size(Kind::Row), size(Kind::Inner), size(Kind::Column));
        let to = self.arena.place(size(Kind::Each) * rows * columns);
        let [rows, inner, columns] = [rows, inner, columns].map(|size| size as u32);
        self.ops.push(Op::Multiply(Multiply { rows, inner, columns, left, right, to }));
        let order: Vec<&Axis> =
            of(Kind::Each).chain(of(Kind::Row)).chain(of(Kind::Column)).collect();
        self.result(node, to, &order)
    }

    /// Whether the axes of a result stand in the order of the graph.
    fn is_in_order(&self, node: &TypedNode, order: &[&Axis]) -> Lowered<bool> {
        let dimensions = self.dimensions(node, order)?;
        Ok(dimensions.iter().all(|dimension| dimension.from == dimension.to))
    }

    /// The copy that brings a result whose axes stand in some order into the order of the graph.
    fn dimensions(&self, node: &TypedNode, order: &[&Axis]) -> Lowered<Vec<Dimension>> {
        let shape = self.shape(node, 0)?;
        let sizes: Vec<usize> = order.iter().map(|axis| axis.size).collect();
        let (from, own) = (strides(&sizes), strides(&shape));
        let dimensions = (order.iter().zip(&from)).filter_map(|(axis, from)| {
            let to = *own.get(axis.out?)?;
            Some(Dimension { size: axis.size, from: *from, to })
        });
        Ok(dimensions.collect())
    }

    /// Brings a result whose axes stand in some order into the order of the graph.
    fn result(&mut self, node: &TypedNode, place: Place, order: &[&Axis]) -> Lowered<()> {
        let dimensions = self.dimensions(node, order)?;
        if dimensions.iter().all(|dimension| dimension.from == dimension.to) {
            return self.give(node, 0, place);
        }
        let to = self.arena.place(place.len as usize);
        self.arrange(node, place, to, &dimensions)?;
        self.give(node, 0, to)
    }

    /// The axes that are longer than one, in the order of the operands.
    fn product_axes(&self, node: &TypedNode, einsum: &EinSum) -> Lowered<Vec<Axis>> {
        let facts = self.model.node_input_facts(node.id).unwrap_or_default();
        let shapes: Vec<&[usize]> =
            facts.iter().map(|fact| fact.shape.as_concrete().unwrap_or(&[])).collect();
        let unsupported = || self.unsupported(node, "it is no product of two values");
        let &[left, right] = shapes.as_slice() else { return Err(unsupported()) };
        let mut axes = Vec::new();
        for axis in einsum.axes.iter_all_axes() {
            let at = [(0, left), (1, right)].map(|(slot, shape)| {
                let position = *axis.inputs.get(slot)?.first()?;
                (*shape.get(position)? != 1).then_some(position)
            });
            let out = axis.outputs.first().and_then(|out| out.first().copied());
            let size = match at {
                [Some(position), _] => left[position],
                [_, Some(position)] => right[position],
                _ => continue,
            };
            let kind = match (at[0].is_some(), at[1].is_some(), out.is_some()) {
                (true, true, true) => Kind::Each,
                (true, false, true) => Kind::Row,
                (true, true, false) => Kind::Inner,
                (false, true, true) => Kind::Column,
                _ => return Err(unsupported()),
            };
            axes.push(Axis { kind, size, at, out });
        }
        axes.sort_by_key(|axis| axis.at);
        Ok(axes)
    }
}

/// What tells layers apart: their sizes and numbers, and how they are stored.
pub(super) fn key(layer: &Layer, how: [usize; 2]) -> [u8; 32] {
    let Matrix { inputs, outputs, values } = &layer.matrix;
    let sizes = [[*inputs, *outputs], how].concat();
    let numbers = values.iter().chain(&layer.bias).flat_map(|number| number.to_le_bytes());
    let bytes: Vec<u8> = sizes.iter().flat_map(|n| n.to_le_bytes()).chain(numbers).collect();
    sha256(&bytes)
}

/// The numbers of a bias, one for every output.
fn bias(tensor: &Tensor, outputs: usize) -> Option<Vec<f32>> {
    numbers(tensor).filter(|bias| bias.len() == outputs)
}

/// Why a unit is refused that works on several rows.
const ONE_STEP: &str = "plans run a recurrent unit for one step of one sequence";

impl Lowering<'_> {
    /// A gated recurrent unit: products on the input and on the state, both with their biases.
    pub(super) fn gru(&mut self, node: &TypedNode, size: usize) -> Lowered<()> {
        let [input, recurrent, state] = [0, 1, 2].map(|slot| self.operand(node, slot));
        let (input, recurrent, state) = (input?.place, recurrent?.place, state?.place);
        let gates = [input, recurrent].map(|place| place.len as usize);
        if gates != [3 * size; 2] || state.len as usize != size {
            return Err(self.unsupported(node, ONE_STEP));
        }
        let to = self.arena.place(size);
        self.ops.push(Op::GruCell(GruCell { input, recurrent, state, to }));
        self.give(node, 0, to)
    }

    /// A long short-term memory: the sum of two products and a bias, and the cell.
    pub(super) fn lstm(&mut self, node: &TypedNode, size: usize) -> Lowered<()> {
        let gates = 4 * size;
        let mut sum = Sum { values: Vec::new(), bias: vec![0.0; gates] };
        self.add_to(&mut sum, self.outlet(node, 0)?, gates);
        let (values, bias) = match sum.values.as_slice() {
            &[input, recurrent] => ([self.place_of(input)?, self.place_of(recurrent)?], sum.bias),
            _ => {
                let all = self.operand(node, 0)?.place;
                ([all, self.stored(&vec![0.0; gates])], vec![0.0; gates])
            }
        };
        let [input, recurrent] = values;
        let cell = self.operand(node, 1)?.place;
        let lengths = [input.len, recurrent.len].map(|len| len as usize);
        if lengths != [gates; 2] || cell.len as usize != size {
            return Err(self.unsupported(node, ONE_STEP));
        }
        let bias = self.weights.add_numbers(&bias);
        let (to, cell_to) = (self.arena.place(size), self.arena.place(size));
        self.ops.push(Op::LstmCell(LstmCell { bias, input, recurrent, cell, to, cell_to }));
        self.give(node, 0, to)?;
        self.give(node, 1, cell_to)
    }

    /// Takes a sum apart into values and a bias, as far as all are as long.
    fn add_to(&self, sum: &mut Sum, outlet: OutletId, length: usize) {
        let constant = self.constant(outlet).and_then(|tensor| numbers(&tensor));
        if let Some(constant) = constant.filter(|constant| constant.len() == length) {
            for (bias, number) in sum.bias.iter_mut().zip(constant) {
                *bias += number;
            }
            return;
        }
        let node = self.model.node(outlet.node);
        let is_sum = node.op_as::<TypedBinOp>().is_some_and(|op| op.0.name() == "Add");
        let is_long = |outlet: &OutletId| {
            let shape = self.model.outlet_fact(*outlet).map(|fact| fact.shape.as_concrete());
            shape.is_ok_and(|shape| shape.is_some_and(|s| s.iter().product::<usize>() == length))
        };
        if is_sum && node.inputs.iter().all(is_long) {
            node.inputs.iter().for_each(|outlet| self.add_to(sum, *outlet, length));
        } else {
            sum.values.push(outlet);
        }
    }
}

/// A sum taken apart.
struct Sum {
    values: Vec<OutletId>,
    bias: Vec<f32>,
}
