//! Operators that tract does not read, or plans do not have, as others that compute the same.

mod attention;
mod quantised;
mod spread;
mod turned;

use tract_onnx::pb::tensor_proto::DataType::{Bool, Float, Int64};
use tract_onnx::pb::{AttributeProto, ModelProto, NodeProto, TensorProto};
use tract_onnx::prelude::*;

use super::nodes::cut;
use super::values::reader;
use crate::graph::guarded;

/// Puts others in place of what can be taken apart; what cannot stays.
pub(super) fn take_apart(file: &mut ModelProto) {
    let is_known = |node: &NodeProto| writer(node).is_some();
    if !file.graph.as_ref().is_some_and(|graph| graph.node.iter().any(is_known)) {
        return;
    }
    let nodes = std::mem::take(&mut file.graph.get_or_insert_default().node);
    for node in nodes {
        let mut parts = Parts { file, node: &node, nodes: vec![], added: vec![] };
        let written = writer(&node).and_then(|write| write(&mut parts));
        let Parts { mut nodes, mut added, .. } = parts;
        let graph = file.graph.get_or_insert_default();
        match written {
            Some(()) => {
                graph.node.append(&mut nodes);
                graph.initializer.append(&mut added);
            }
            None => graph.node.push(node),
        }
    }
}

/// Writes the parts of a node; none where that is not possible.
type Writer = fn(&mut Parts<'_>) -> Option<()>;

fn writer(node: &NodeProto) -> Option<Writer> {
    match node.op_type.as_str() {
        "Attention" if node.domain.is_empty() => Some(attention::write),
        "ConvTranspose" => Some(spread::write),
        "QuantizeLinear"
        | "DequantizeLinear"
        | "DynamicQuantizeLinear"
        | "QLinearMatMul"
        | "MatMulInteger"
        | "ConvInteger" => Some(quantised::write),
        "GRU" | "LSTM" | "RNN" if turned::is_backwards(node) => Some(turned::write),
        _ => None,
    }
}

/// What is written in the place of one node.
struct Parts<'a> {
    /// All that stands before the node.
    file: &'a ModelProto,
    node: &'a NodeProto,
    nodes: Vec<NodeProto>,
    added: Vec<TensorProto>,
}

impl Parts<'_> {
    /// The name of an input that is given.
    fn input(&self, slot: usize) -> Option<String> {
        self.node.input.get(slot).filter(|name| !name.is_empty()).cloned()
    }

    /// A value that stands in the file.
    fn constant(&self, name: &str) -> Option<&TensorProto> {
        let graph = self.file.graph.as_ref()?;
        let written = |node: &&NodeProto| {
            node.op_type == "Constant" && node.output.iter().any(|output| output == name)
        };
        graph
            .initializer
            .iter()
            .find(|tensor| tensor.name == name)
            .or_else(|| graph.node.iter().find(written)?.attribute.first()?.t.as_ref())
    }

    fn is_wanted(&self, slot: usize) -> bool {
        self.node.output.get(slot).is_some_and(|name| !name.is_empty())
    }

    fn attribute(&self, name: &str) -> Option<&AttributeProto> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    fn whole(&self, name: &str) -> i64 {
        self.attribute(name).map_or(0, |attribute| attribute.i)
    }

    /// Whole numbers of an attribute, or as many of one where it has none.
    fn wholes(&self, name: &str, count: usize, usual: i64) -> Vec<i64> {
        let given = self.attribute(name).map(|attribute| attribute.ints.clone());
        given.filter(|given| given.len() == count).unwrap_or_else(|| vec![usual; count])
    }

    /// Type and sizes of a value that stands before the node.
    fn fact(&self, name: &str) -> Option<(DatumType, Vec<i64>)> {
        // An output that is an input as well would lose its sizes.
        let behind = format!("{name}.behind");
        let mut file = self.file.clone();
        file.graph.as_mut()?.node.push(NodeProto {
            op_type: "Identity".into(),
            input: vec![name.to_owned()],
            output: vec![behind.clone()],
            ..NodeProto::default()
        });
        let read = || reader().model_for_proto_model(&cut(&file, &[behind]))?.into_typed();
        let model = guarded(read).ok()?;
        let fact = model.output_fact(0).ok()?;
        let sizes = fact.shape.as_concrete()?.iter().map(|size| *size as i64).collect();
        Some((fact.datum_type, sizes))
    }

    fn add(&mut self, operator: &str, inputs: &[&str]) -> String {
        self.add_with(operator, inputs, Vec::new())
    }

    fn add_with(
        &mut self,
        operator: &str,
        inputs: &[&str],
        attribute: Vec<AttributeProto>,
    ) -> String {
        let name = self.name("step", self.nodes.len());
        self.nodes.push(NodeProto {
            op_type: operator.to_owned(),
            name: name.clone(),
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![name.clone()],
            attribute,
            ..NodeProto::default()
        });
        name
    }

    /// Numbers in another shape.
    fn reshaped(&mut self, x: &str, sizes: &[i64]) -> String {
        let sizes = self.row(sizes);
        self.add("Reshape", &[x, &sizes])
    }

    fn transposed(&mut self, x: &str, order: &[i64]) -> String {
        self.add_with("Transpose", &[x], vec![wholes("perm", order)])
    }

    /// The same numbers from the last to the first along an axis.
    fn backwards(&mut self, x: &str, axis: i64) -> String {
        let [last, before, axis] = [-1, i64::MIN, axis].map(|number| self.row(&[number]));
        self.add("Slice", &[x, &last, &before, &axis, &last])
    }

    fn row(&mut self, numbers: &[i64]) -> String {
        let (dims, int64_data) = (vec![numbers.len() as i64], numbers.to_vec());
        let data_type = Int64 as i32;
        self.tensor(TensorProto { data_type, dims, int64_data, ..TensorProto::default() })
    }

    fn number(&mut self, number: f32) -> String {
        let (data_type, float_data) = (Float as i32, vec![number]);
        self.tensor(TensorProto { data_type, float_data, ..TensorProto::default() })
    }

    fn truths(&mut self, dims: Vec<i64>, truths: impl Iterator<Item = bool>) -> String {
        let (data_type, int32_data) = (Bool as i32, truths.map(i32::from).collect());
        self.tensor(TensorProto { data_type, dims, int32_data, ..TensorProto::default() })
    }

    fn tensor(&mut self, tensor: TensorProto) -> String {
        let name = self.name("constant", self.added.len());
        self.added.push(TensorProto { name: name.clone(), ..tensor });
        name
    }

    /// A name that no other value has.
    fn name(&self, kind: &str, number: usize) -> String {
        format!("{}.apart.{kind}.{number}", self.node.output.first().map_or("", String::as_str))
    }

    /// Makes a value one of the node's outputs.
    fn give(&mut self, slot: usize, from: &str) -> Option<()> {
        if let Some(output) = self.node.output.get(slot).filter(|name| !name.is_empty()) {
            self.add("Identity", &[from]);
            self.nodes.last_mut()?.output = vec![output.clone()];
        }
        Some(())
    }
}

fn whole(name: &str, i: i64) -> AttributeProto {
    AttributeProto { name: name.into(), r#type: 2, i, ..AttributeProto::default() }
}

fn wholes(name: &str, ints: &[i64]) -> AttributeProto {
    let ints = ints.to_vec();
    AttributeProto { name: name.into(), r#type: 7, ints, ..AttributeProto::default() }
}
