//! The same networks for many questions in one call: what a peer of teams and allocators is given.
//!
//! The graphs are written from the matched layers of a file, as someone would write them for an engine that
//! runs one node after the other: rows that all questions share are embedded once, everything else has a
//! leading dimension B.

use prost::Message;
use tract_onnx::pb;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::{Dimension, dimension};
use tract_onnx::pb::type_proto;

use crate::graph::{Graph, Inputs};
use crate::matching::{AgentLayers, Layer, Matrix, Step, match_agent, match_team_value};
use sortie_plans::CompileError;

const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;
/// Stands for minus infinity among logits.
const BLOCKED: f32 = -1.0e30;
/// Flags in front of the relation's columns: own row, member of the team.
const FLAGS: usize = 2;

/// An agent's network for B agents of one frame: `entities [N, D], self_index [B], visible [B, N] ->
/// utilities [B, U]`. Embeddings, keys and values are computed once for all agents.
pub fn batched_agents_onnx(onnx: &[u8]) -> Result<Vec<u8>, CompileError> {
    let graph = Graph::read(onnx)?;
    let layers = match_agent(&graph)?;
    let mut model = Model::default();
    let (n, b) = (Size::Named("N"), Size::Named("B"));
    model.input("entities", DataType::Float, &[n, Size::Fixed(graph.columns)]);
    model.input("self_index", DataType::Int64, &[b]);
    model.input("visible", DataType::Bool, &[b, n]);
    model.output("utilities", &[b, Size::Fixed(graph.actions)]);
    let embedding = model.layer("embed", "entities", &layers.embed);
    let own = model.node("own", "Gather", &[&embedding, "self_index"], &[("axis", &[0])]);
    let query = model.layer("query", &own, &layers.query);
    let key = model.product("key", &embedding, &layers.key);
    let value = model.product("value", &embedding, &layers.value);
    // [H, B, e], [H, e, N], [H, N, e]: the mask [B, N] broadcasts over the heads.
    let query = model.heads(&query, &layers, 0, &[1, 0, 2]);
    let key = model.heads(&key, &layers, 0, &[1, 2, 0]);
    let value = model.heads(&value, &layers, 0, &[1, 0, 2]);
    let attended = model.attend(&query, &key, &value, "visible");
    let joined = model.join(&attended, &layers, &[1, 0, 2]);
    model.rest([&joined, &own], &layers, "utilities")?;
    Ok(model.into_bytes("batched_agents"))
}

/// An allocator's network for B teams of one state: `entities [N, d], self_index [B], own [B, N, 1],
/// team [B, N, 1], relation [B, N, F], visible [N] -> value [B, 1]`. The features are multiplied once; own row,
/// team and relation are added for each question.
pub fn batched_team_values_onnx(onnx: &[u8]) -> Result<Vec<u8>, CompileError> {
    let graph = Graph::read(onnx)?;
    let Inputs::TeamValue(roles) = graph.inputs else {
        return Err(CompileError::OtherNetwork { want: "an allocator's".into() });
    };
    let layers = match_team_value(&graph)?;
    let (d, f) = (roles.features, roles.relations);
    let mut model = Model::default();
    let (n, b, one) = (Size::Named("N"), Size::Named("B"), Size::Fixed(1));
    model.input("entities", DataType::Float, &[n, Size::Fixed(d)]);
    model.input("self_index", DataType::Int64, &[b, Size::Fixed(2)]);
    model.input("own", DataType::Float, &[b, n, one]);
    model.input("team", DataType::Float, &[b, n, one]);
    model.input("relation", DataType::Float, &[b, n, Size::Fixed(f)]);
    model.input("visible", DataType::Bool, &[n]);
    model.output("value", &[b, one]);
    let embedding = model.team_embedding(&layers.embed, d, f);
    let own = model.node("own_row", "GatherND", &[&embedding, "self_index"], &[]);
    let query = model.layer("query", &own, &layers.query);
    let key = model.product("key", &embedding, &layers.key);
    let value = model.product("value", &embedding, &layers.value);
    // [B, H, 1, e], [B, H, e, N], [B, H, N, e]: the mask [N] broadcasts over the rest.
    let query = model.lone_heads(&query, &layers);
    let key = model.heads(&key, &layers, 1, &[0, 2, 3, 1]);
    let value = model.heads(&value, &layers, 1, &[0, 2, 1, 3]);
    let attended = model.attend(&query, &key, &value, "visible");
    let joined = model.join(&attended, &layers, &[0, 2, 1, 3]);
    model.rest([&joined, &own], &layers, "value")?;
    Ok(model.into_bytes("batched_team_values"))
}

/// A size of an input or output.
#[derive(Clone, Copy)]
enum Size {
    Fixed(usize),
    Named(&'static str),
}

/// A model under construction. Nodes are named by what they compute.
#[derive(Default)]
struct Model(pb::GraphProto);

impl Model {
    fn input(&mut self, name: &str, kind: DataType, shape: &[Size]) {
        self.0.input.push(described(name, kind, shape));
    }

    fn output(&mut self, name: &str, shape: &[Size]) {
        self.0.output.push(described(name, DataType::Float, shape));
    }

    /// Adds a node with one output, which carries its name, and returns that.
    fn node(
        &mut self,
        name: &str,
        operator: &str,
        inputs: &[&str],
        attributes: &[(&str, &[i64])],
    ) -> String {
        self.0.node.push(pb::NodeProto {
            name: name.to_owned(),
            op_type: operator.to_owned(),
            input: inputs.iter().map(ToString::to_string).collect(),
            output: vec![name.to_owned()],
            attribute: attributes.iter().map(|(name, values)| attribute(name, values)).collect(),
            ..Default::default()
        });
        name.to_owned()
    }

    fn floats(&mut self, name: &str, shape: &[usize], values: &[f32]) -> String {
        let raw = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constant(name, DataType::Float, shape, raw)
    }

    fn integers(&mut self, name: &str, values: &[i64]) -> String {
        let raw = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constant(name, DataType::Int64, &[values.len()], raw)
    }

    fn constant(&mut self, name: &str, kind: DataType, shape: &[usize], raw: Vec<u8>) -> String {
        self.0.initializer.push(pb::TensorProto {
            name: name.to_owned(),
            data_type: kind as i32,
            dims: shape.iter().map(|size| *size as i64).collect(),
            raw_data: raw,
            ..Default::default()
        });
        name.to_owned()
    }

    fn product(&mut self, name: &str, input: &str, matrix: &Matrix) -> String {
        let shape = [matrix.inputs, matrix.outputs];
        let weight = self.floats(&format!("{name}.weight"), &shape, &matrix.values);
        self.node(&format!("{name}.product"), "MatMul", &[input, &weight], &[])
    }

    fn layer(&mut self, name: &str, input: &str, layer: &Layer) -> String {
        let product = self.product(name, input, &layer.matrix);
        let bias = self.floats(&format!("{name}.bias"), &[layer.bias.len()], &layer.bias);
        let sum = self.node(&format!("{name}.sum"), "Add", &[&product, &bias], &[]);
        self.rectified(name, sum, layer.relu)
    }

    fn rectified(&mut self, name: &str, sum: String, relu: bool) -> String {
        if relu { self.node(&format!("{name}.relu"), "Relu", &[&sum], &[]) } else { sum }
    }

    /// The embedding `[B, N, E]` of rows that differ in flags and relation only.
    fn team_embedding(&mut self, layer: &Layer, features: usize, relations: usize) -> String {
        let outputs = layer.matrix.outputs;
        let part = |first: usize, rows: usize| Matrix {
            inputs: rows,
            outputs,
            values: layer.matrix.values[first * outputs..][..rows * outputs].to_vec(),
        };
        let shared = Layer { matrix: part(0, features), bias: layer.bias.clone(), relu: false };
        let mut sum = self.layer("embed", "entities", &shared);
        let flags = [("own", features, 1), ("team", features + 1, 1)];
        let relation = (relations > 0).then_some(("relation", features + FLAGS, relations));
        for (input, first, rows) in flags.into_iter().chain(relation) {
            let added = self.product(&format!("embed.{input}"), input, &part(first, rows));
            sum = self.node(&format!("embed.with.{input}"), "Add", &[&sum, &added], &[]);
        }
        self.rectified("embed.all", sum, layer.relu)
    }

    /// Splits the last axis into heads, behind `leading` axes and the rows', and orders the axes.
    fn heads(
        &mut self,
        input: &str,
        layers: &AgentLayers,
        leading: usize,
        order: &[i64],
    ) -> String {
        let width = layers.key.outputs / layers.heads;
        let mut shape = vec![0; leading + 1];
        shape.extend([layers.heads as i64, width as i64]);
        let shape = self.integers(&format!("{input}.split"), &shape);
        let split = self.node(&format!("{input}.heads"), "Reshape", &[input, &shape], &[]);
        self.node(&format!("{input}.ordered"), "Transpose", &[&split], &[("perm", order)])
    }

    /// Heads of one query for each question.
    fn lone_heads(&mut self, query: &str, layers: &AgentLayers) -> String {
        let shape = [0, layers.heads as i64, 1, (layers.key.outputs / layers.heads) as i64];
        let shape = self.integers("query.split", &shape);
        self.node("query.heads", "Reshape", &[query, &shape], &[])
    }

    /// Masked attention; the scale is part of the query.
    fn attend(&mut self, query: &str, key: &str, value: &str, visible: &str) -> String {
        let blocked = self.floats("blocked", &[], &[BLOCKED]);
        let nothing = self.floats("nothing", &[], &[0.0]);
        let scores = self.node("scores", "MatMul", &[query, key], &[]);
        let masked = self.node("masked", "Where", &[visible, &scores, &blocked], &[]);
        let shares = self.node("softmax", "Softmax", &[&masked], &[("axis", &[-1])]);
        let shares = self.node("weights", "Where", &[visible, &shares, &nothing], &[]);
        self.node("mixed", "MatMul", &[&shares, value], &[])
    }

    /// Heads side by side again: `[B, E]`.
    fn join(&mut self, mixed: &str, layers: &AgentLayers, order: &[i64]) -> String {
        let ordered = self.node("mixed.ordered", "Transpose", &[mixed], &[("perm", order)]);
        let shape = self.integers("join", &[-1, layers.key.outputs as i64]);
        self.node("joined", "Reshape", &[&ordered, &shape], &[])
    }

    /// What follows the attention, down to `output`, of what the heads mixed and of the own row.
    fn rest(
        &mut self,
        [joined, own]: [&str; 2],
        layers: &AgentLayers,
        output: &str,
    ) -> Result<(), CompileError> {
        let mut last = match &layers.skip {
            None => self.layer("output", joined, &layers.output),
            Some(skip) => {
                let both = self.node("looked", "Concat", &[joined, own], &[("axis", &[1])]);
                let mut output = layers.output.clone();
                output.matrix.inputs += skip.inputs;
                output.matrix.values.extend(&skip.values);
                self.layer("output", &both, &output)
            }
        };
        if layers.targets.is_some() {
            let (what, got) = ("the number of pointing heads".into(), 1);
            return Err(CompileError::Size { what, got, want: 0 });
        }
        for (index, step) in layers.steps.iter().enumerate() {
            let Step::Dense(layer) = step else {
                let (what, got) = ("the number of recurrent units".into(), 1);
                return Err(CompileError::Size { what, got, want: 0 });
            };
            last = self.layer(&format!("dense.{index}"), &last, layer);
        }
        self.node(output, "Identity", &[&last], &[]);
        Ok(())
    }

    fn into_bytes(mut self, name: &str) -> Vec<u8> {
        self.0.name = name.to_owned();
        pb::ModelProto {
            ir_version: IR_VERSION,
            producer_name: "sortie".to_owned(),
            opset_import: vec![pb::OperatorSetIdProto { version: OPSET, ..Default::default() }],
            graph: Some(self.0),
            ..Default::default()
        }
        .encode_to_vec()
    }
}

/// An integer, or a list of integers where there are several.
fn attribute(name: &str, values: &[i64]) -> pb::AttributeProto {
    use pb::attribute_proto::AttributeType;
    let mut attribute = pb::AttributeProto { name: name.to_owned(), ..Default::default() };
    if let [value] = values {
        attribute.r#type = AttributeType::Int as i32;
        attribute.i = *value;
    } else {
        attribute.r#type = AttributeType::Ints as i32;
        attribute.ints = values.to_vec();
    }
    attribute
}

fn described(name: &str, kind: DataType, shape: &[Size]) -> pb::ValueInfoProto {
    let dimension = |size: &Size| Dimension {
        value: Some(match *size {
            Size::Fixed(size) => dimension::Value::DimValue(size as i64),
            Size::Named(name) => dimension::Value::DimParam(name.to_owned()),
        }),
        ..Default::default()
    };
    let shape = pb::TensorShapeProto { dim: shape.iter().map(dimension).collect() };
    let tensor = type_proto::Tensor { elem_type: kind as i32, shape: Some(shape) };
    let value = Some(type_proto::Value::TensorType(tensor));
    pb::ValueInfoProto {
        name: name.to_owned(),
        r#type: Some(pb::TypeProto { value, ..Default::default() }),
        ..Default::default()
    }
}
