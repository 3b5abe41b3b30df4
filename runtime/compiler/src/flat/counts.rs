//! What a simplified graph costs.

use std::collections::BTreeMap;

use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::Cost;
use tract_onnx::tract_core::ops::cnn::Conv;
use tract_onnx::tract_core::ops::einsum::EinSum;
use tract_onnx::tract_core::ops::scan::Scan;
use tract_onnx::tract_hir::internal::DimLike;

/// Nodes per operator, but for inputs and constants.
pub(super) fn operators(model: &TypedModel) -> BTreeMap<String, usize> {
    let mut operators = BTreeMap::new();
    let computing = model.nodes.iter().filter(|node| !node.inputs.is_empty());
    for node in computing {
        *operators.entry(node.op.name().into_owned()).or_insert(0) += 1;
    }
    operators
}

/// Multiply-adds of products and convolutions in one run; none where it is not known how often a loop turns.
pub(super) fn multiply_adds(model: &TypedModel) -> Option<u64> {
    let mut sum = 0_u64;
    for node in &model.nodes {
        let inputs = model.node_input_facts(node.id).ok()?;
        if let Some(turns) = node.op_as::<Scan>() {
            let count = turns.iteration_count(&inputs)?.to_usize().ok()? as u64;
            sum = sum.saturating_add(count.saturating_mul(multiply_adds(&turns.body)?));
        } else if node.op_is::<EinSum>() || node.op_is::<Conv>() {
            for (cost, count) in node.op.cost(&inputs).ok()? {
                if matches!(cost, Cost::FMA(_)) {
                    sum = sum.saturating_add(count.to_usize().ok()? as u64);
                }
            }
        }
    }
    Some(sum)
}
