//! What a file draws at random, and the likeliest in its place.

use std::collections::HashMap;

use tract_onnx::pb::{
    AttributeProto, GraphProto, NodeProto, TensorProto, tensor_proto::DataType::Float,
};

/// What is written behind the name of an output whose numbers are to be the likeliest.
pub(super) const LIKELIEST: &str = ":likeliest";

/// Operators that draw.
const DRAWING: [&str; 6] = [
    "RandomNormal",
    "RandomNormalLike",
    "RandomUniform",
    "RandomUniformLike",
    "Multinomial",
    "Bernoulli",
];

/// Whether a node draws at random.
pub(super) fn draws(node: &NodeProto) -> bool {
    DRAWING.contains(&node.op_type.as_str())
}

/// Puts a normal's mean and the most probable of several in place of what is drawn; what has no such number stays.
pub(super) fn take_likeliest(graph: &mut GraphProto) {
    let mut nodes = std::mem::take(&mut graph.node);
    let logarithms = nodes.iter().filter(|node| node.op_type == "Log");
    let logarithms: HashMap<String, String> = logarithms
        .filter_map(|node| Some((node.output.first()?.clone(), node.input.first()?.clone())))
        .collect();
    for node in nodes.iter_mut().filter(|node| node.op_type == "Multinomial") {
        // The most probable is the same among probabilities, whose logarithms may be infinite.
        for input in &mut node.input {
            if let Some(probabilities) = logarithms.get(input) {
                input.clone_from(probabilities);
            }
        }
    }
    graph.node = nodes.into_iter().flat_map(likeliest).collect();
}

fn likeliest(node: NodeProto) -> Vec<NodeProto> {
    let attribute = |name: &str| node.attribute.iter().find(|attribute| attribute.name == name);
    let is = |name: &str, usual: i64| attribute(name).map_or(usual, |attribute| attribute.i);
    let float = i64::from(Float as i32);
    match node.op_type.as_str() {
        "RandomNormalLike" if is("dtype", float) == float => {
            let mean = attribute("mean").map_or(0.0, |attribute| attribute.f);
            means(node, mean)
        }
        "Multinomial" if is("sample_size", 1) == 1 => {
            let kind = is("dtype", 6);
            largest(node, kind)
        }
        _ => vec![node],
    }
}

/// The mean as often as the node draws.
fn means(node: NodeProto, mean: f32) -> Vec<NodeProto> {
    let sizes = format!("{}.sizes", node.output.first().map_or("", String::as_str));
    let value = TensorProto {
        data_type: Float as i32,
        dims: vec![1],
        float_data: vec![mean],
        ..Default::default()
    };
    let value =
        AttributeProto { name: "value".into(), r#type: 4, t: Some(value), ..Default::default() };
    let shape = NodeProto {
        op_type: "Shape".into(),
        input: node.input,
        output: vec![sizes.clone()],
        ..Default::default()
    };
    let filled = NodeProto {
        op_type: "ConstantOfShape".into(),
        input: vec![sizes],
        attribute: vec![value],
        name: node.name,
        output: node.output,
        ..Default::default()
    };
    vec![shape, filled]
}

/// The place of the largest, in the type that the node draws.
fn largest(node: NodeProto, kind: i64) -> Vec<NodeProto> {
    let number =
        |name: &str, i| AttributeProto { name: name.into(), r#type: 2, i, ..Default::default() };
    let place = format!("{}.place", node.output.first().map_or("", String::as_str));
    let chosen = NodeProto {
        op_type: "ArgMax".into(),
        input: node.input,
        attribute: vec![number("axis", 1), number("keepdims", 1)],
        name: node.name,
        output: vec![place.clone()],
        ..Default::default()
    };
    let cast = NodeProto {
        op_type: "Cast".into(),
        input: vec![place],
        output: node.output,
        attribute: vec![number("to", kind)],
        ..Default::default()
    };
    vec![chosen, cast]
}
