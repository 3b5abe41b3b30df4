//! The sizes of a file's inputs: a batch of one, and what the file leaves open as it is asked for.

use std::collections::BTreeSet;

use sortie_plans::CompileError;
use tract_onnx::pb;
use tract_onnx::pb::tensor_shape_proto::dimension::Value;
use tract_onnx::pb::type_proto;

use super::values::{dims, listed};

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
