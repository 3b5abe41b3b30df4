//! What becomes of a file before it is simplified: what it asks for and tract passes over, for such a policy would be
//! computed, and proved, as another one; sizes that it leaves open; and numbers of 16 bits as those of 32 that they are.

use std::collections::BTreeSet;

use sortie_plans::CompileError;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::dimension::Value;
use tract_onnx::pb::{
    self, AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto,
    type_proto,
};
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::internal::f16;

use super::nodes::cut;
use super::values::{dims, listed, reader};
use crate::graph::guarded;

/// The functions of recurrent units, which are the only ones that are read.
const UNITS: [(&str, &[&str]); 3] =
    [("RNN", &["Tanh"]), ("GRU", &["Sigmoid", "Tanh"]), ("LSTM", &["Sigmoid", "Tanh", "Tanh"])];

/// Refuses a graph with a node that would be computed otherwise than it says.
pub(super) fn refuse(graph: &GraphProto) -> Result<(), CompileError> {
    for node in &graph.node {
        if let Some(what) = passed_over(node) {
            let (node, operator) = (node.name.clone(), node.op_type.clone());
            return Err(CompileError::PassedOver { node, operator, what });
        }
        for inner in node.attribute.iter().filter_map(|attribute| attribute.g.as_ref()) {
            refuse(inner)?;
        }
    }
    Ok(())
}

/// Refuses recurrent units that are told how long their histories are, unless that is all there is.
pub(super) fn refuse_lengths(file: &ModelProto) -> Result<(), CompileError> {
    let nodes = file.graph.as_ref().map_or(&[][..], |graph| &graph.node);
    for node in nodes {
        let is_unit = UNITS.iter().any(|(unit, _)| *unit == node.op_type);
        let given = [node.input.first(), node.input.get(4).filter(|name| !name.is_empty())];
        if let ([Some(history), Some(lengths)], true) = (given, is_unit)
            && guarded(|| is_whole(file, node, [history, lengths])) != Ok(true)
        {
            let (node, operator) = (node.name.clone(), node.op_type.clone());
            let what = "sequence_lens that may leave out a part of the history".to_owned();
            return Err(CompileError::PassedOver { node, operator, what });
        }
    }
    Ok(())
}

/// Whether the lengths are constant and those of the history.
fn is_whole(file: &ModelProto, node: &NodeProto, names: [&String; 2]) -> TractResult<bool> {
    // An output that is an input as well would lose its sizes.
    let behind = names.map(|name| format!("{name}.behind"));
    let mut file = file.clone();
    let nodes = names.iter().zip(&behind).map(|(name, behind)| NodeProto {
        op_type: "Identity".into(),
        input: vec![(*name).clone()],
        output: vec![behind.clone()],
        ..Default::default()
    });
    file.graph.get_or_insert_default().node.extend(nodes);
    let model =
        reader().model_for_proto_model(&cut(&file, &behind))?.into_typed()?.into_decluttered()?;
    let batch_first = node.attribute.iter().any(|a| a.name == "layout" && a.i == 1);
    let turns = model.output_fact(0)?.shape[usize::from(batch_first)].to_i64()?;
    let Some(lengths) = model.output_fact(1)?.konst.clone() else { return Ok(false) };
    let lengths = lengths.cast_to::<i64>()?;
    let lengths = lengths.to_plain_array_view::<i64>()?;
    Ok(lengths.iter().all(|length| *length == turns))
}

fn passed_over(node: &NodeProto) -> Option<String> {
    let attribute = |name: &str| node.attribute.iter().find(|attribute| attribute.name == name);
    if let Some((_, usual)) = UNITS.iter().find(|(unit, _)| *unit == node.op_type) {
        let other = |name: &str, is_other: fn(&AttributeProto) -> bool| {
            attribute(name).filter(|attribute| is_other(attribute)).map(|_| name.to_owned())
        };
        return attribute("activations")
            .and_then(|functions| other_functions(functions, usual))
            .or_else(|| other("clip", |_| true))
            .or_else(|| other("input_forget", |forget| forget.i != 0))
            .or_else(|| other("direction", |direction| direction.s == b"reverse"));
    }
    match node.op_type.as_str() {
        "Celu" => {
            let alpha = attribute("alpha").filter(|alpha| alpha.f.is_nan() || alpha.f <= 0.0);
            alpha.map(|alpha| format!("alpha = {}", alpha.f))
        }
        "GlobalLpPool" => Some("a root of its sums".to_owned()),
        "BatchNormalization" => attribute("training_mode")
            .filter(|mode| mode.i != 0)
            .map(|_| "the means of training".to_owned()),
        _ => None,
    }
}

/// Functions of a unit that are not those it has where it names none; each direction has its own.
fn other_functions(functions: &AttributeProto, usual: &[&str]) -> Option<String> {
    let names = functions.strings.iter().map(|name| String::from_utf8_lossy(name));
    let is_other = names.clone().zip(usual.iter().cycle()).any(|(name, usual)| name != *usual);
    is_other.then(|| names.collect::<Vec<_>>().join(", "))
}

/// A size that the file leaves open.
struct Open {
    /// Its name in the file; without one the input's with the place behind it.
    name: String,
    input: usize,
    axis: usize,
}

/// Fixes all sizes of the inputs, and leaves out those that the file stores.
///
/// A name that leads the sizes of an input is the batch, and 1 wherever it stands, unless something else is asked for.
pub(super) fn fix(
    graph: &mut pb::GraphProto,
    sizes: &[(String, usize)],
) -> Result<(), CompileError> {
    let stored: BTreeSet<&str> = graph.initializer.iter().map(|t| t.name.as_str()).collect();
    graph.input.retain(|input| !stored.contains(input.name.as_str()));
    let open = open_sizes(graph)?;
    if let Some((name, _)) = sizes.iter().find(|(name, _)| !open.iter().any(|o| o.name == *name)) {
        return Err(CompileError::NotInFile {
            what: "open size".into(),
            name: name.clone(),
            found: listed(open.iter().map(|open| format!("`{}`", open.name))),
        });
    }
    let batch: BTreeSet<&str> =
        open.iter().filter(|open| open.axis == 0).map(|open| open.name.as_str()).collect();
    for place in &open {
        let asked = sizes.iter().find(|(name, _)| *name == place.name).map(|(_, size)| *size);
        let size = asked.or_else(|| batch.contains(place.name.as_str()).then_some(1));
        let Some(size) = size else { return Err(left_open(graph, &open, &place.name)) };
        let dims = graph.input.get_mut(place.input).and_then(dims_mut);
        if let Some(dim) = dims.and_then(|dims| dims.get_mut(place.axis)) {
            dim.value = Some(Value::DimValue(i64::try_from(size).unwrap_or(i64::MAX)));
        }
    }
    Ok(())
}

fn open_sizes(graph: &pb::GraphProto) -> Result<Vec<Open>, CompileError> {
    let mut open = Vec::new();
    for (input, value) in graph.input.iter().enumerate() {
        let Some(dims) = dims(value) else {
            let reason = format!("its input `{}` has no sizes", value.name);
            return Err(CompileError::NoPolicy { reason });
        };
        for (axis, dim) in dims.iter().enumerate() {
            let name = match &dim.value {
                Some(Value::DimValue(1..)) => continue,
                Some(Value::DimParam(name)) if !name.is_empty() => name.clone(),
                _ => format!("{}.{axis}", value.name),
            };
            open.push(Open { name, input, axis });
        }
    }
    Ok(open)
}

fn left_open(graph: &pb::GraphProto, open: &[Open], name: &str) -> CompileError {
    let having = open.iter().filter(|open| open.name == name);
    let inputs = having.filter_map(|open| graph.input.get(open.input));
    let values = listed(inputs.map(|input| format!("`{}`", input.name)));
    CompileError::OpenSize { name: name.to_owned(), values }
}

fn dims_mut(value: &mut pb::ValueInfoProto) -> Option<&mut Vec<pb::tensor_shape_proto::Dimension>> {
    let type_proto::Value::TensorType(tensor) = value.r#type.as_mut()?.value.as_mut()?;
    Some(&mut tensor.shape.as_mut()?.dim)
}

const FLOAT: i32 = DataType::Float as i32;

/// Attributes that hold a type.
const TYPES: [&str; 3] = ["to", "dtype", "output_dtype"];

/// Widens all numbers of 16 bits.
pub(super) fn widen(file: &mut ModelProto) {
    if let Some(graph) = &mut file.graph {
        widen_graph(graph);
    }
}

fn widen_graph(graph: &mut GraphProto) {
    graph.initializer.iter_mut().for_each(widen_tensor);
    let values = graph.input.iter_mut().chain(&mut graph.output).chain(&mut graph.value_info);
    values.for_each(widen_value);
    for attribute in graph.node.iter_mut().flat_map(|node| &mut node.attribute) {
        widen_attribute(attribute);
    }
}

fn widen_attribute(attribute: &mut AttributeProto) {
    if TYPES.contains(&attribute.name.as_str()) && is_half(attribute.i as i32) {
        attribute.i = i64::from(FLOAT);
    }
    attribute.t.iter_mut().for_each(widen_tensor);
    attribute.g.iter_mut().for_each(widen_graph);
}

fn widen_value(value: &mut ValueInfoProto) {
    let kind = value.r#type.as_mut().and_then(|kind| kind.value.as_mut());
    if let Some(type_proto::Value::TensorType(tensor)) = kind
        && is_half(tensor.elem_type)
    {
        tensor.elem_type = FLOAT;
    }
}

fn is_half(kind: i32) -> bool {
    kind == DataType::Float16 as i32 || kind == DataType::Bfloat16 as i32
}

fn widen_tensor(tensor: &mut TensorProto) {
    if !is_half(tensor.data_type) {
        return;
    }
    let is_brain = tensor.data_type == DataType::Bfloat16 as i32;
    let number = |bits: u16| match is_brain {
        true => f32::from_bits(u32::from(bits) << 16),
        false => f16::from_bits(bits).to_f32(),
    };
    let raw = tensor.raw_data.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]));
    let listed = tensor.int32_data.iter().map(|bits| *bits as u16);
    tensor.float_data = raw.chain(listed).map(number).collect();
    tensor.raw_data.clear();
    tensor.int32_data.clear();
    tensor.data_type = FLOAT;
}
