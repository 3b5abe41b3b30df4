//! Weights that are no numbers: a file that holds such was broken on its way, and what it computes is no policy.
//!
//! Infinity alone has its uses: limits that are none, and masks that close. It is refused where numbers are multiplied.

use std::collections::HashMap;

use sortie_plans::CompileError;
use tract_onnx::pb::{GraphProto, NodeProto, TensorProto, tensor_proto::DataType};

/// Operators that multiply or divide by their weights, or make numbers of integers by them.
const MULTIPLY: [&str; 17] = [
    "BatchNormalization",
    "Conv",
    "ConvTranspose",
    "DequantizeLinear",
    "Div",
    "Einsum",
    "GRU",
    "Gemm",
    "GroupNormalization",
    "InstanceNormalization",
    "LSTM",
    "LayerNormalization",
    "MatMul",
    "Mul",
    "QuantizeLinear",
    "RMSNormalization",
    "RNN",
];

/// Operators that hand on what they are given, in another shape.
const HAND_ON: [&str; 10] = [
    "Concat",
    "Expand",
    "Flatten",
    "Gather",
    "Identity",
    "Reshape",
    "Slice",
    "Squeeze",
    "Transpose",
    "Unsqueeze",
];

/// Constants that hold a number that is not finite.
#[derive(Clone, Default)]
struct Broken<'g> {
    /// The name that the constant has in the file, and whether one of its numbers is NaN, by the names of what holds it.
    values: HashMap<&'g str, (&'g str, bool)>,
}

/// Refuses a graph that multiplies by a constant that is not finite, or uses one that is NaN.
pub(super) fn refuse(graph: &GraphProto) -> Result<(), CompileError> {
    refuse_within(graph, Broken::default())
}

fn refuse_within<'g>(graph: &'g GraphProto, mut broken: Broken<'g>) -> Result<(), CompileError> {
    for tensor in &graph.initializer {
        broken.note(&tensor.name, tensor);
    }
    for node in &graph.node {
        for attribute in &node.attribute {
            if let (Some(tensor), Some(output)) = (&attribute.t, node.output.first()) {
                broken.note(output, tensor);
            }
            if let Some(inner) = &attribute.g {
                refuse_within(inner, broken.clone())?;
            }
        }
        broken.refuse_node(node)?;
    }
    Ok(())
}

impl<'g> Broken<'g> {
    fn note(&mut self, name: &'g str, tensor: &TensorProto) {
        let (mut is_broken, mut is_nan) = (false, false);
        for number in floats(tensor) {
            is_broken |= !number.is_finite();
            is_nan |= number.is_nan();
        }
        if is_broken {
            self.values.insert(name, (name, is_nan));
        }
    }

    fn refuse_node(&mut self, node: &'g NodeProto) -> Result<(), CompileError> {
        let found = node.input.iter().find_map(|name| self.values.get(name.as_str()).copied());
        let Some((name, is_nan)) = found else { return Ok(()) };
        let operator = node.op_type.as_str();
        if is_nan || MULTIPLY.contains(&operator) {
            let layer = format!("the constant `{name}`, used by {operator},").into();
            return Err(CompileError::NonFiniteWeight { layer });
        }
        if HAND_ON.contains(&operator) {
            let outputs = node.output.iter().map(|output| (output.as_str(), (name, is_nan)));
            self.values.extend(outputs);
        }
        Ok(())
    }
}

/// The numbers of a tensor of floats of 32 bits; of others none.
fn floats(tensor: &TensorProto) -> impl Iterator<Item = f32> {
    let is_float = tensor.data_type == DataType::Float as i32;
    let raw = tensor.raw_data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
    raw.chain(tensor.float_data.iter().copied()).filter(move |_| is_float)
}
