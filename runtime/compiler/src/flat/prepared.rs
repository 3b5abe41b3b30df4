//! What becomes of a file before it is read: its own functions in the place of their calls, its sizes fixed, and numbers of
//! other widths as those of 32 bits.

use std::collections::{BTreeSet, HashMap};

use sortie_plans::CompileError;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::dimension::Value;
use tract_onnx::pb::{
    self, AttributeProto, FunctionProto, GraphProto, ModelProto, NodeProto, TensorProto,
    ValueInfoProto, type_proto,
};
use tract_onnx::tract_hir::internal::f16;

use super::values::{dims, listed};

/// Functions that call each other, one inside the other; a file with more calls itself without end.
const MOST_CALLS: usize = 16;

/// Nodes that calls may become.
const MOST_NODES: usize = 100_000;

/// Puts the nodes of a file's own functions in the place of their calls. What calls itself without end stays, and is
/// refused as an operator that nobody knows.
pub(super) fn place_functions(file: &mut ModelProto) {
    let functions = std::mem::take(&mut file.functions);
    let graph = file.graph.get_or_insert_default();
    for _ in 0..MOST_CALLS {
        let is_call = |node: &NodeProto| function_of(&functions, node).is_some();
        if !graph.node.iter().any(is_call) || graph.node.len() > MOST_NODES {
            return;
        }
        let nodes = std::mem::take(&mut graph.node).into_iter();
        let placed = nodes.flat_map(|node| match function_of(&functions, &node) {
            Some(function) => body(function, &node),
            None => vec![node],
        });
        graph.node = placed.collect();
    }
}

/// The function that a node calls; one whose nodes hold graphs is left to be refused.
fn function_of<'f>(functions: &'f [FunctionProto], node: &NodeProto) -> Option<&'f FunctionProto> {
    functions.iter().find(|function| {
        function.name.as_deref() == Some(node.op_type.as_str())
            && function.domain.as_deref().unwrap_or_default() == node.domain
            && function.node.iter().flat_map(|node| &node.attribute).all(|a| a.g.is_none())
    })
}

/// The nodes of a function for one call: its inputs and outputs are the call's, other values get names of their own.
fn body(function: &FunctionProto, call: &NodeProto) -> Vec<NodeProto> {
    let outside = |inside: &[String], outside: &[String]| -> HashMap<String, String> {
        let none = std::iter::repeat(String::new());
        inside.iter().cloned().zip(outside.iter().cloned().chain(none)).collect()
    };
    let mut names = outside(&function.input, &call.input);
    // An output that nobody wants is a value like others.
    names.extend(
        outside(&function.output, &call.output).into_iter().filter(|(_, to)| !to.is_empty()),
    );
    let own = format!("{}.{}", call.output.first().map_or("", String::as_str), call.op_type);
    let renamed = |name: &String| match names.get(name) {
        Some(outside) => outside.clone(),
        None if name.is_empty() => String::new(),
        None => format!("{own}.{name}"),
    };
    let argument = |attribute: &AttributeProto| {
        if attribute.ref_attr_name.is_empty() {
            return Some(attribute.clone());
        }
        let given = call.attribute.iter().find(|given| given.name == attribute.ref_attr_name)?;
        Some(AttributeProto { name: attribute.name.clone(), ..given.clone() })
    };
    let placed = function.node.iter().map(|node| NodeProto {
        name: format!("{own}.{}", node.name),
        input: node.input.iter().map(renamed).collect(),
        output: node.output.iter().map(renamed).collect(),
        attribute: node.attribute.iter().filter_map(argument).collect(),
        ..node.clone()
    });
    placed.collect()
}

/// A size that the file leaves open.
struct Open {
    /// Its name in the file; without one the input's with the place behind it.
    name: String,
    is_named: bool,
    input: usize,
    axis: usize,
}

/// Fixes all sizes of the inputs, and leaves out those that the file stores.
///
/// A name that leads the sizes of an input is the batch, and 1 wherever it stands, unless something else is asked for. Such
/// names come back, each with an input that it leads.
pub(super) fn fix(
    graph: &mut pb::GraphProto,
    sizes: &[(String, usize)],
) -> Result<Vec<(String, String)>, CompileError> {
    let stored: BTreeSet<&str> = graph.initializer.iter().map(|t| t.name.as_str()).collect();
    graph.input.retain(|input| !stored.contains(input.name.as_str()));
    let open = open_sizes(graph, sizes)?;
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
    if !sizes.is_empty() {
        // What is said of them may be of other sizes now.
        let shapes =
            graph.output.iter_mut().filter_map(|output| output.r#type.as_mut()?.value.as_mut());
        for type_proto::Value::TensorType(tensor) in shapes {
            tensor.shape = None;
        }
    }
    let is_asked = |open: &&Open| sizes.iter().any(|(name, _)| *name == open.name);
    let batches = open.iter().filter(|open| open.axis == 0 && open.is_named && !is_asked(open));
    let leads = |open: &Open| Some((open.name.clone(), graph.input.get(open.input)?.name.clone()));
    Ok(batches.filter_map(leads).collect())
}

/// The sizes that the file leaves open, and those of `sizes` that it fixes at something else: a batch, for instance.
fn open_sizes(
    graph: &pb::GraphProto,
    sizes: &[(String, usize)],
) -> Result<Vec<Open>, CompileError> {
    let mut open = Vec::new();
    for (input, value) in graph.input.iter().enumerate() {
        let Some(dims) = dims(value) else {
            let reason = format!("its input `{}` has no sizes", value.name);
            return Err(CompileError::NoPolicy { reason });
        };
        for (axis, dim) in dims.iter().enumerate() {
            let place = format!("{}.{axis}", value.name);
            let named = match &dim.value {
                Some(Value::DimValue(1..)) if sizes.iter().any(|(name, _)| *name == place) => None,
                Some(Value::DimValue(1..)) => continue,
                Some(Value::DimParam(name)) if !name.is_empty() => Some(name.clone()),
                _ => None,
            };
            let is_named = named.is_some();
            let name = named.unwrap_or(place);
            open.push(Open { name, is_named, input, axis });
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

/// Makes numbers of 16 bits those of 32 that they are.
pub(super) fn widen(file: &mut ModelProto) {
    let is_half = |kind| kind == DataType::Float16 as i32 || kind == DataType::Bfloat16 as i32;
    file.graph.iter_mut().for_each(|graph| retype(graph, &is_half));
}

/// Rounds numbers of 64 bits to 32: plans have no others.
pub(super) fn narrow(file: &mut ModelProto) {
    let is_double = |kind| kind == DataType::Double as i32;
    file.graph.iter_mut().for_each(|graph| retype(graph, &is_double));
}

/// Makes floats of some types those of 32 bits, wherever a graph names or holds them.
fn retype(graph: &mut GraphProto, is_other: &dyn Fn(i32) -> bool) {
    graph.initializer.iter_mut().for_each(|tensor| retype_tensor(tensor, is_other));
    let values = graph.input.iter_mut().chain(&mut graph.output).chain(&mut graph.value_info);
    values.for_each(|value| retype_value(value, is_other));
    for attribute in graph.node.iter_mut().flat_map(|node| &mut node.attribute) {
        if TYPES.contains(&attribute.name.as_str()) && is_other(attribute.i as i32) {
            attribute.i = i64::from(FLOAT);
        }
        attribute.t.iter_mut().for_each(|tensor| retype_tensor(tensor, is_other));
        attribute.g.iter_mut().for_each(|graph| retype(graph, is_other));
    }
}

fn retype_value(value: &mut ValueInfoProto, is_other: &dyn Fn(i32) -> bool) {
    let kind = value.r#type.as_mut().and_then(|kind| kind.value.as_mut());
    if let Some(type_proto::Value::TensorType(tensor)) = kind
        && is_other(tensor.elem_type)
    {
        tensor.elem_type = FLOAT;
    }
}

fn retype_tensor(tensor: &mut TensorProto, is_other: &dyn Fn(i32) -> bool) {
    if !is_other(tensor.data_type) {
        return;
    }
    let (raw, kind) = (std::mem::take(&mut tensor.raw_data), tensor.data_type);
    tensor.float_data = if kind == DataType::Double as i32 {
        let eight = |bytes: &[u8]| bytes.try_into().map(f64::from_le_bytes).unwrap_or_default();
        let raw = raw.chunks_exact(8).map(eight);
        raw.chain(std::mem::take(&mut tensor.double_data)).map(|number| number as f32).collect()
    } else {
        let number = |bits: u16| match kind == DataType::Bfloat16 as i32 {
            true => f32::from_bits(u32::from(bits) << 16),
            false => f16::from_bits(bits).to_f32(),
        };
        let raw = raw.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]));
        let listed = std::mem::take(&mut tensor.int32_data).into_iter().map(|bits| bits as u16);
        raw.chain(listed).map(number).collect()
    };
    tensor.data_type = FLOAT;
}
