//! Weights that are no numbers: a file that holds such was broken on its way, and what it computes is no policy.
//!
//! Infinity alone has its uses: limits that are none, and masks that close. It is refused where numbers are multiplied. Numbers that
//! are merely larger than a layer's are looked for once plan and file differ.

use std::collections::HashMap;

use sortie_plans::CompileError;
use tract_onnx::pb::{GraphProto, ModelProto, TensorProto, tensor_proto::DataType};

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
const HAND_ON: [&str; 11] = [
    "Cast",
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

/// Beyond it no layer that learned has a weight, and below its inverse none is divided by.
const WILD: f32 = 1e9;

/// What a constant of a file holds.
#[derive(Clone, Copy, Default)]
struct Constant<'g> {
    name: &'g str,
    is_nan: bool,
    highest: f32,
    /// The magnitudes of its largest number, and of its smallest one that is not zero.
    largest: f32,
    smallest: f32,
}

/// A constant, and an operator that is given it.
type Use<'g> = (Constant<'g>, &'g str);

/// Refuses a graph that multiplies by a constant that is not finite, takes it from numbers, adds infinity, or uses one that is NaN.
pub(super) fn refuse(graph: &GraphProto) -> Result<(), CompileError> {
    let is_broken = |(constant, operator): &Use<'_>| match *operator {
        _ if constant.is_nan => true,
        "Add" => constant.highest == f32::INFINITY,
        "Sub" => constant.largest.is_infinite(),
        other => constant.largest.is_infinite() && MULTIPLY.contains(&other),
    };
    match uses(graph).into_iter().find(is_broken) {
        Some((Constant { name, .. }, operator)) => {
            let layer = format!("the constant `{name}`, used by {operator},").into();
            Err(CompileError::NonFiniteWeight { layer })
        }
        None => Ok(()),
    }
}

/// The constant of a file that is larger than a layer's numbers, or by which it divides so that what it gives is, and the number:
/// masks may hold such.
pub(crate) fn wild_constant(file: &ModelProto) -> Option<(String, f32)> {
    let uses = file.graph.as_ref().map(uses).unwrap_or_default();
    uses.into_iter().find_map(|(constant, operator)| {
        let divides = operator == "Div" && constant.smallest < 1.0 / WILD;
        let counts = ["Add", "Sub"].contains(&operator) || MULTIPLY.contains(&operator);
        let wild = if divides { constant.smallest } else { constant.largest };
        let is_wild = counts && (divides || constant.largest > WILD);
        is_wild.then(|| (constant.name.to_owned(), wild))
    })
}

fn uses(graph: &GraphProto) -> Vec<Use<'_>> {
    let mut found = Vec::new();
    note_uses(graph, HashMap::new(), &mut found);
    found
}

/// Notes all uses of constants in a graph; `known` are those around it, by the names of what holds them.
fn note_uses<'g>(
    graph: &'g GraphProto,
    mut known: HashMap<&'g str, Constant<'g>>,
    found: &mut Vec<Use<'g>>,
) {
    let held = |name: &'g str, tensor| Some((name, Constant::of(name, tensor)?));
    known.extend(graph.initializer.iter().filter_map(|tensor| held(&tensor.name, tensor)));
    for node in &graph.node {
        for attribute in &node.attribute {
            if let (Some(tensor), Some(output)) = (&attribute.t, node.output.first()) {
                known.extend(held(output, tensor));
            }
            if let Some(inner) = &attribute.g {
                note_uses(inner, known.clone(), found);
            }
        }
        for name in &node.input {
            let Some(constant) = known.get(name.as_str()).copied() else { continue };
            found.push((constant, &node.op_type));
            if HAND_ON.contains(&node.op_type.as_str()) {
                known.extend(node.output.iter().map(|output| (output.as_str(), constant)));
            }
        }
    }
}

impl<'g> Constant<'g> {
    /// What a tensor of floats of 32 bits holds; of others nothing is known.
    fn of(name: &'g str, tensor: &TensorProto) -> Option<Self> {
        if tensor.data_type != DataType::Float as i32 {
            return None;
        }
        let raw = tensor.raw_data.as_chunks::<4>().0.iter();
        let raw = raw.map(|bytes| f32::from_le_bytes(*bytes));
        let (highest, smallest) = (f32::NEG_INFINITY, f32::INFINITY);
        let mut constant = Self { name, highest, smallest, ..Self::default() };
        for number in raw.chain(tensor.float_data.iter().copied()) {
            constant.is_nan |= number.is_nan();
            constant.highest = constant.highest.max(number);
            constant.largest = constant.largest.max(number.abs());
            if number != 0.0 {
                constant.smallest = constant.smallest.min(number.abs());
            }
        }
        Some(constant)
    }
}
