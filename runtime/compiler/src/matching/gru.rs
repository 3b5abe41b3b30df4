//! Matrix products, with bias and ReLU where they follow, and the gated recurrent units that are written out with them.

use sortie_plans::{CompileError, Layer, Matrix};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{Gather, Slice};
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::einsum::EinSum;
use tract_onnx::tract_core::ops::element_wise::ElementWiseOp;
use tract_onnx::tract_hir::internal::DimLike;

use crate::graph::{Graph, Inputs, Roles};

const HINT: &str = "a recurrent unit is n + z (h - n) with r, z = Sigmoid(W y + b + U h + c) and \
                    n = Tanh(W y + b + r (U h + c)), h an input and the result an output of the graph";

/// The layers of a unit: gates r, z and n, R outputs each.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GruLayers {
    /// On the input.
    pub(crate) input: [Layer; 3],
    /// On the state.
    pub(crate) recurrent: [Layer; 3],
}

/// A unit found in the graph, and what it is applied to.
pub(crate) struct FoundGru {
    pub(crate) layers: GruLayers,
    pub(crate) input: OutletId,
}

/// Matches the unit whose new state `outlet` is; none where it is no state that the graph gives out.
pub(crate) fn match_gru(graph: &Graph, outlet: OutletId) -> Result<Option<FoundGru>, CompileError> {
    let Inputs::Agent(Roles { memory: Some(memory), .. }) = graph.inputs else { return Ok(None) };
    let given = graph.model.outputs.get(memory.output);
    if given.is_none_or(|given| !same(graph, *given, outlet)) {
        return Ok(None);
    }
    let unsupported = |outlet| graph.unsupported(outlet, HINT);
    let operands = graph.operands(outlet, "Add").ok_or_else(|| unsupported(outlet))?;
    let new = operands.into_iter().find(|operand| is(graph, *operand, "Tanh"));
    let new = new.ok_or_else(|| unsupported(outlet))?;
    let state = graph.input(memory.input).ok_or_else(|| unsupported(outlet))?;
    let step = operands.into_iter().find(|operand| !same(graph, *operand, new));
    let step = step.ok_or_else(|| unsupported(outlet))?;
    let [update, distance] = with(graph, step, "Mul", |operand| is(graph, operand, "Sigmoid"))
        .ok_or_else(|| unsupported(step))?;
    let is_distance = graph
        .operands(distance, "Sub")
        .is_some_and(|[a, b]| same(graph, a, state) && same(graph, b, new));
    if !is_distance {
        return Err(unsupported(distance));
    }
    let unit = Unit { graph, state };
    let (input_new, kept) = unit.candidate(new)?;
    let [reset, kept] = with(graph, kept, "Mul", |operand| is(graph, operand, "Sigmoid"))
        .ok_or_else(|| unsupported(kept))?;
    let (recurrent_new, _) = unit.one(kept, true)?;
    let (input_reset, recurrent_reset, input) = unit.gate(reset)?;
    let (input_update, recurrent_update, other) = unit.gate(update)?;
    let (input_new, last) = input_new;
    if !(same(graph, input, other) && same(graph, input, last)) {
        return Err(unsupported(outlet));
    }
    let layers = GruLayers {
        input: [input_reset, input_update, input_new],
        recurrent: [recurrent_reset, recurrent_update, recurrent_new],
    };
    Ok(Some(FoundGru { layers, input }))
}

/// Finds the parts of a unit whose state is known.
struct Unit<'g> {
    graph: &'g Graph,
    state: OutletId,
}

/// A sum of products, and all of its biases added up; none where the graph has none.
#[derive(Default)]
struct Sum {
    products: Vec<(Matrix, OutletId)>,
    bias: Vec<f32>,
}

/// One term of a sum.
enum Term {
    Product(Matrix, OutletId),
    Bias(OutletId, Option<[usize; 2]>),
    Other(OutletId),
}

impl Unit<'_> {
    /// `Sigmoid(W y + b + U h + c)`: both layers and y. All of the bias is the input's.
    fn gate(&self, gate: OutletId) -> Result<(Layer, Layer, OutletId), CompileError> {
        let sum = self.argument(gate)?;
        let Sum { mut products, bias } = self.sum(sum)?;
        let place = products.iter().position(|(_, input)| same(self.graph, *input, self.state));
        let (recurrent, _) = products.swap_remove(place.ok_or_else(|| self.unsupported(sum))?);
        let [(input, from)] = <[_; 1]>::try_from(products).map_err(|_| self.unsupported(sum))?;
        if input.outputs != recurrent.outputs {
            return Err(self.unsupported(sum));
        }
        let nothing = vec![0.0; recurrent.outputs];
        let bias = if bias.is_empty() { nothing.clone() } else { bias };
        Ok((layer(input, bias), layer(recurrent, nothing), from))
    }

    /// `Tanh(W y + b + rest)`: the layer with y, and the rest.
    fn candidate(&self, new: OutletId) -> Result<((Layer, OutletId), OutletId), CompileError> {
        let sum = self.argument(new)?;
        let is_rest = |operand: OutletId| self.graph.operands(operand, "Mul").is_some();
        let [rest, layer] =
            with(self.graph, sum, "Add", is_rest).ok_or_else(|| self.unsupported(sum))?;
        Ok((self.one(layer, false)?, rest))
    }

    /// One layer, of the state or not, and what it is applied to.
    fn one(&self, outlet: OutletId, of_state: bool) -> Result<(Layer, OutletId), CompileError> {
        let Sum { products, bias } = self.sum(outlet)?;
        let [(matrix, input)] =
            <[_; 1]>::try_from(products).map_err(|_| self.unsupported(outlet))?;
        if same(self.graph, input, self.state) != of_state {
            return Err(self.unsupported(outlet));
        }
        let bias = if bias.is_empty() { vec![0.0; matrix.outputs] } else { bias };
        Ok((layer(matrix, bias), input))
    }

    /// The products and the summed biases of a sum, slices of either applied.
    fn sum(&self, outlet: OutletId) -> Result<Sum, CompileError> {
        let Sum { mut products, mut bias } = Sum::default();
        for term in self.terms(outlet, None) {
            match term {
                Term::Product(matrix, input) => products.push((matrix, input)),
                Term::Bias(constant, range) => self.add_bias(&mut bias, constant, range)?,
                Term::Other(outlet) => return Err(self.unsupported(outlet)),
            }
        }
        let outputs = products.first().map_or(0, |(matrix, _)| matrix.outputs);
        if !bias.is_empty() && bias.len() != outputs {
            return Err(self.unsupported(outlet));
        }
        Ok(Sum { products, bias })
    }

    fn add_bias(
        &self,
        bias: &mut Vec<f32>,
        constant: OutletId,
        range: Option<[usize; 2]>,
    ) -> Result<(), CompileError> {
        let unsupported = || self.unsupported(constant);
        let len = self.graph.constant(constant).ok_or_else(unsupported)?.len();
        let values = bias_values(self.graph, constant, len).ok_or_else(unsupported)?;
        let [start, end] = range.unwrap_or([0, len]);
        let values = values.get(start..end).ok_or_else(unsupported)?;
        if bias.is_empty() {
            bias.extend(values);
        } else if bias.len() == values.len() {
            bias.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        } else {
            return Err(unsupported());
        }
        Ok(())
    }

    /// The terms of a sum, of which `range` of the columns counts.
    fn terms(&self, outlet: OutletId, range: Option<[usize; 2]>) -> Vec<Term> {
        let graph = self.graph;
        if graph.constant(outlet).is_some() {
            return vec![Term::Bias(outlet, range)];
        }
        if let Some(operands) = graph.operands(outlet, "Add") {
            return operands.into_iter().flat_map(|operand| self.terms(operand, range)).collect();
        }
        let node = graph.node(outlet);
        if let (Some(slice), &[input], None) = (node.op_as::<Slice>(), &*node.inputs, range)
            && let (Ok(start), Ok(end)) = (slice.start.to_usize(), slice.end.to_usize())
        {
            return self.terms(input, Some([start, end]));
        }
        let product = match_product(graph, outlet).ok();
        let product = product.and_then(|(matrix, input)| match range {
            Some([start, end]) if start < end && end <= matrix.outputs => {
                Some((matrix.columns(start, end - start), input))
            }
            Some(_) => None,
            None => Some((matrix, input)),
        });
        vec![product.map_or(Term::Other(outlet), |(matrix, input)| Term::Product(matrix, input))]
    }

    /// What a function of one argument is applied to.
    fn argument(&self, outlet: OutletId) -> Result<OutletId, CompileError> {
        let input = self.graph.node(outlet).inputs.first().copied();
        input.ok_or_else(|| self.unsupported(outlet))
    }

    fn unsupported(&self, outlet: OutletId) -> CompileError {
        self.graph.unsupported(outlet, HINT)
    }
}

fn layer(matrix: Matrix, bias: Vec<f32>) -> Layer {
    Layer { matrix, bias, relu: false }
}

/// Whether `outlet` is the function of that name.
pub(super) fn is(graph: &Graph, outlet: OutletId, function: &str) -> bool {
    let node = graph.node(outlet);
    node.op_as::<ElementWiseOp>().is_some_and(|op| op.0.name() == function)
}

/// Whether two outlets are the same but for their shape.
fn same(graph: &Graph, a: OutletId, b: OutletId) -> bool {
    graph.source(a) == graph.source(b)
}

/// The operands of a binary operator, first the one that `matches`.
pub(super) fn with(
    graph: &Graph,
    outlet: OutletId,
    operator: &str,
    matches: impl Fn(OutletId) -> bool,
) -> Option<[OutletId; 2]> {
    match graph.operands(outlet, operator)? {
        [a, b] if matches(a) => Some([a, b]),
        [a, b] if matches(b) => Some([b, a]),
        _ => None,
    }
}

/// A layer found in the graph, and what it is applied to.
pub(crate) struct Found {
    pub(crate) layer: Layer,
    pub(crate) input: OutletId,
    /// Whether the graph adds a bias at all.
    pub(crate) has_bias: bool,
}

/// Matches `relu(x W + b)`; ReLU and bias may be missing.
pub(crate) fn match_layer(graph: &Graph, outlet: OutletId) -> Result<Found, CompileError> {
    let relu =
        graph.with_constant(outlet, "Max").filter(|[_, low]| graph.uniform(*low) == Some(0.0));
    let sum = relu.map_or(outlet, |[sum, _]| sum);
    let biased = graph.with_constant(sum, "Add");
    let product = biased.map_or(sum, |[product, _]| product);
    let (matrix, input) = match_product(graph, product)?;
    let bias = match biased {
        Some([_, bias]) => bias_values(graph, bias, matrix.outputs)
            .ok_or_else(|| graph.unsupported(sum, "a bias has one value per output"))?,
        None => vec![0.0; matrix.outputs],
    };
    let layer = Layer { matrix, bias, relu: relu.is_some() };
    Ok(Found { layer, input, has_bias: biased.is_some() })
}

/// Matches `relu(x W + y V + b)`; ReLU and bias may be missing. Both layers have the bias of the sum, and its ReLU.
pub(crate) fn match_sum(graph: &Graph, outlet: OutletId) -> Option<[Found; 2]> {
    let relu =
        graph.with_constant(outlet, "Max").filter(|[_, low]| graph.uniform(*low) == Some(0.0));
    let sum = relu.map_or(outlet, |[sum, _]| sum);
    let (constants, products): (Vec<_>, Vec<_>) =
        terms(graph, sum).into_iter().partition(|term| graph.constant(*term).is_some());
    let (&[a, b], biases @ ([] | [_])) = (products.as_slice(), constants.as_slice()) else {
        return None;
    };
    let found = |product| {
        let (matrix, input) = match_product(graph, product).ok()?;
        let bias = match biases.first() {
            Some(bias) => bias_values(graph, *bias, matrix.outputs)?,
            None => vec![0.0; matrix.outputs],
        };
        let layer = Layer { matrix, bias, relu: relu.is_some() };
        Some(Found { layer, input, has_bias: !biases.is_empty() })
    };
    Some([found(a)?, found(b)?])
}

/// The terms of a sum of values.
pub(super) fn terms(graph: &Graph, sum: OutletId) -> Vec<OutletId> {
    let node = graph.node(sum);
    let adds = node.op_as::<TypedBinOp>().is_some_and(|binary| binary.0.name() == "Add");
    if !adds {
        return vec![sum];
    }
    node.inputs.iter().flat_map(|input| terms(graph, *input)).collect()
}

/// Matches the product of a value and a constant matrix.
pub(crate) fn match_product(
    graph: &Graph,
    outlet: OutletId,
) -> Result<(Matrix, OutletId), CompileError> {
    const HINT: &str = "a layer is a product with a constant matrix, then a bias, then a ReLU";
    let node = graph.node(outlet);
    let unsupported = || graph.unsupported(outlet, HINT);
    let einsum = node.op_as::<EinSum>().ok_or_else(unsupported)?;
    let &[a, b] = node.inputs.as_slice() else { return Err(unsupported()) };
    let (constant, slot, input) = match (graph.constant(a), graph.constant(b)) {
        (None, Some(constant)) => (constant, 1, a),
        (Some(constant), None) => (constant, 0, b),
        _ => return Err(unsupported()),
    };
    let matrix = as_matrix(einsum, &constant, slot).ok_or_else(unsupported)?;
    Ok((matrix, input))
}

/// The two operands of a product of two values.
pub(crate) fn match_product_of_two(graph: &Graph, outlet: OutletId) -> Option<[OutletId; 2]> {
    let node = graph.node(outlet);
    node.op_as::<EinSum>()?;
    match node.inputs.as_slice() {
        &[a, b] if graph.constant(a).is_none() && graph.constant(b).is_none() => Some([a, b]),
        _ => None,
    }
}

/// The rows of which `outlet` is the own one.
pub(super) fn own_row(graph: &Graph, outlet: OutletId, own_index: OutletId) -> Option<OutletId> {
    let node = graph.node(outlet);
    node.op_as::<Gather>().filter(|gather| gather.axis == 0)?;
    match node.inputs.as_slice() {
        &[rows, index] if graph.source(index) == own_index => Some(graph.source(rows)),
        _ => None,
    }
}

/// Removes a multiplication by one number, as attention scales its scores.
pub(crate) fn match_scale(graph: &Graph, outlet: OutletId) -> (OutletId, f32) {
    let scaled = graph.with_constant(outlet, "Mul");
    match scaled.and_then(|[value, scale]| Some((value, graph.uniform(scale)?))) {
        Some(found) => found,
        None => (outlet, 1.0),
    }
}

/// Reads a constant operand as `[inputs, outputs]`: summed axes first, in the order of the other operand.
pub(crate) fn as_matrix(einsum: &EinSum, constant: &Tensor, slot: usize) -> Option<Matrix> {
    let (mut summed, mut kept) = (Vec::new(), Vec::new());
    for axis in einsum.axes.iter_all_axes() {
        let Some(&position) = axis.inputs.get(slot)?.first() else { continue };
        let other = axis.inputs.get(1 - slot)?.first();
        match (other, axis.outputs.first()?.first()) {
            (Some(&order), None) => summed.push((order, position)),
            (None, Some(&order)) => kept.push((order, position)),
            _ => return None,
        }
    }
    summed.sort_unstable();
    kept.sort_unstable();
    let size = |axes: &[(usize, usize)]| {
        axes.iter().map(|&(_, position)| constant.shape().get(position).copied()).product()
    };
    let (inputs, outputs): (Option<usize>, Option<usize>) = (size(&summed), size(&kept));
    let order: Vec<usize> = summed.iter().chain(&kept).map(|&(_, position)| position).collect();
    let view = constant.to_plain_array_view::<f32>().ok()?;
    let values = view.permuted_axes(order).iter().copied().collect();
    Some(Matrix { inputs: inputs?, outputs: outputs?, values })
}

/// The values of a bias, one per output.
pub(super) fn bias_values(graph: &Graph, outlet: OutletId, outputs: usize) -> Option<Vec<f32>> {
    let constant = graph.constant(outlet)?;
    let values: Vec<f32> = constant.to_plain_array_view::<f32>().ok()?.iter().copied().collect();
    (values.len() == outputs).then_some(values)
}
