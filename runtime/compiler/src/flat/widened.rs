//! Numbers of 16 bits in a file as those of 32 that they are: plans compute in 32.

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{
    AttributeProto, GraphProto, ModelProto, TensorProto, ValueInfoProto, type_proto,
};
use tract_onnx::tract_hir::internal::f16;

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
