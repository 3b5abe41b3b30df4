//! Matrix products, with bias and ReLU where they follow.

use sortie_plans::{CompileError, Layer, Matrix};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::einsum::EinSum;

use crate::graph::Graph;

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
