//! A file's nodes by what they compute, and the part of a file that some outputs need.

use std::collections::{HashMap, HashSet};

use tract_onnx::pb::tensor_proto::DataType::Float;
use tract_onnx::pb::{self, AttributeProto, GraphProto, NodeProto, TensorProto};

/// Operators whose output is their first input in another shape or type.
const CARRIERS: [&str; 6] = ["Identity", "Cast", "Squeeze", "Unsqueeze", "Reshape", "Flatten"];

/// Nodes by the names of their outputs.
pub(super) struct Nodes<'a> {
    makers: HashMap<&'a str, &'a pb::NodeProto>,
}

/// The choice of the largest of some scores.
pub(super) struct ArgMax {
    /// The name of the scores.
    pub(super) scores: String,
    /// The axis of the scores along which it chooses; negative from the end.
    pub(super) axis: i64,
}

impl<'a> Nodes<'a> {
    pub(super) fn of(graph: &'a pb::GraphProto) -> Self {
        let outputs =
            |node: &'a pb::NodeProto| node.output.iter().map(move |output| (output.as_str(), node));
        Self { makers: graph.node.iter().flat_map(outputs).collect() }
    }

    /// The choice that an output is, whatever its shape and type.
    pub(super) fn argmax(&self, output: &str) -> Option<ArgMax> {
        let mut node = *self.makers.get(output)?;
        // No way is longer, but for circles.
        for _ in 0..self.makers.len() {
            if node.op_type == "ArgMax" {
                let axis = node.attribute.iter().find(|attribute| attribute.name == "axis");
                let axis = axis.map_or(0, |axis| axis.i);
                return Some(ArgMax { scores: node.input.first()?.clone(), axis });
            }
            let is_alone = node.op_type == "Concat" && node.input.len() == 1;
            if !is_alone && !CARRIERS.contains(&node.op_type.as_str()) {
                return None;
            }
            node = self.makers.get(node.input.first()?.as_str())?;
        }
        None
    }

    /// The node behind an output that draws at random.
    pub(super) fn drawn(&self, output: &str) -> Option<&'a pb::NodeProto> {
        let behind = self.behind([output]);
        let mut makers = behind.iter().filter_map(|name| self.makers.get(name.as_str()));
        makers.find(|node| draws(node)).copied()
    }

    /// The names of all that these values are computed from, their own among them.
    pub(super) fn behind<'n>(&self, values: impl IntoIterator<Item = &'n str>) -> HashSet<String> {
        let mut open: Vec<String> = values.into_iter().map(str::to_owned).collect();
        let mut behind = HashSet::new();
        while let Some(name) = open.pop() {
            if let Some(node) = self.makers.get(name.as_str())
                && !behind.contains(&name)
            {
                open.extend(read_by(node));
            }
            behind.insert(name);
        }
        behind
    }
}

/// The names that a node reads; those inside its own graphs may be of values outside.
fn read_by(node: &pb::NodeProto) -> Vec<String> {
    let mut names: Vec<String> =
        node.input.iter().filter(|name| !name.is_empty()).cloned().collect();
    for attribute in &node.attribute {
        for graph in attribute.g.iter().chain(&attribute.graphs) {
            names.extend(graph.output.iter().map(|output| output.name.clone()));
            names.extend(graph.node.iter().flat_map(read_by));
        }
    }
    names
}

/// The file with nothing but what these outputs need; no output may be named twice.
pub(super) fn cut(file: &pb::ModelProto, outputs: &[String]) -> pb::ModelProto {
    let mut file = file.clone();
    if let Some(graph) = &mut file.graph {
        let needed = Nodes::of(graph).behind(outputs.iter().map(String::as_str));
        graph.node.retain(|node| node.output.iter().any(|output| needed.contains(output)));
        graph.initializer.retain(|tensor| needed.contains(&tensor.name));
        graph.input.retain(|input| needed.contains(&input.name));
        // Notes on values between are of sizes that may be others now.
        graph.value_info.clear();
        let bare = |name: &String| pb::ValueInfoProto { name: name.clone(), ..Default::default() };
        graph.output = outputs.iter().map(bare).collect();
    }
    file
}

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
