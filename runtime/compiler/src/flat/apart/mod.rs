//! Operators that tract does not read, or plans do not have, as others that compute the same.

mod functions;
mod loops;
mod quantised;
mod resize;

use tract_onnx::pb::tensor_proto::DataType::{Bool, Float, Int64};
use tract_onnx::pb::{AttributeProto, ModelProto, NodeProto, TensorProto};
use tract_onnx::prelude::*;

use super::nodes::cut;
use super::values::reader;
use crate::graph::guarded;

/// Loops inside of loops that are laid open; deeper ones stay.
const DEEPEST: usize = 4;

/// Puts others in place of what can be taken apart; what cannot stays.
pub(super) fn take_apart(file: &mut ModelProto) {
    for _ in 0..DEEPEST {
        rewrite(file, |node| (node.op_type == "Loop").then_some(loops::laid_open as Writer));
    }
    rewrite(file, writer);
}

/// Puts what the writers of nodes write in the place of these.
fn rewrite(file: &mut ModelProto, writer: impl Fn(&NodeProto) -> Option<Writer>) {
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
    let is_classical = node.domain == "ai.onnx.ml";
    match node.op_type.as_str() {
        "Attention" if node.domain.is_empty() => Some(attention),
        "BatchNormalization" => Some(functions::batch_norm),
        "Celu" => Some(functions::celu),
        "ConvTranspose" => Some(quantised::spread),
        "QuantizeLinear"
        | "DequantizeLinear"
        | "DynamicQuantizeLinear"
        | "QLinearMatMul"
        | "MatMulInteger"
        | "ConvInteger" => Some(quantised::write),
        "Concat" => Some(functions::joined),
        "LogSoftmax" => Some(functions::log_softmax),
        "ReduceLogSumExp" => Some(functions::log_sum_exp),
        "Resize" | "Upsample" => Some(resize::resize),
        "Normalizer" if is_classical => Some(functions::normalizer),
        "Scaler" if is_classical => Some(functions::scaler),
        "Selu" => Some(functions::selu),
        "GRU" | "LSTM" | "RNN" if is_backwards(node) => Some(turned),
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

    /// What an Expand repeats to this value.
    fn expanded(&self, name: &str) -> Option<String> {
        let graph = self.file.graph.as_ref()?;
        let makes = |node: &&NodeProto| node.output.first().is_some_and(|output| output == name);
        let maker = graph.node.iter().find(makes)?;
        if maker.op_type == "Expand" { maker.input.first().cloned() } else { None }
    }

    fn is_wanted(&self, slot: usize) -> bool {
        self.node.output.get(slot).is_some_and(|name| !name.is_empty())
    }

    fn attribute(&self, name: &str) -> Option<&AttributeProto> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    /// The version of the operators that the file uses.
    fn version(&self) -> i64 {
        let own = self.file.opset_import.iter().find(|set| ["", "ai.onnx"].contains(&&*set.domain));
        own.map_or(0, |set| set.version)
    }

    fn is_upsample(&self) -> bool {
        self.node.op_type == "Upsample"
    }

    fn text(&self, name: &str, usual: &str) -> String {
        let text = self.attribute(name).and_then(|attribute| str::from_utf8(&attribute.s).ok());
        text.unwrap_or(usual).to_owned()
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
        let model = self.until(name, |model| model.into_typed())?;
        let fact = model.output_fact(0).ok()?;
        let sizes = fact.shape.as_concrete()?.iter().map(|size| *size as i64).collect();
        Some((fact.datum_type, sizes))
    }

    /// The numbers of a value that nothing which goes in changes.
    fn computed(&self, name: &str) -> Option<Vec<f64>> {
        let model = self.until(name, |model| model.into_typed()?.into_decluttered())?;
        let constant = model.output_fact(0).ok()?.konst.clone()?;
        let numbers = constant.cast_to::<f64>().ok()?;
        Some(numbers.to_plain_array_view::<f64>().ok()?.iter().copied().collect())
    }

    /// The graph of a value that stands before the node.
    fn until(
        &self,
        name: &str,
        read: impl FnOnce(InferenceModel) -> TractResult<TypedModel>,
    ) -> Option<TypedModel> {
        // An output that is an input as well would lose its sizes.
        let behind = format!("{name}.behind");
        let mut file = self.file.clone();
        file.graph.as_mut()?.node.push(NodeProto {
            op_type: "Identity".into(),
            input: vec![name.to_owned()],
            output: vec![behind.clone()],
            ..NodeProto::default()
        });
        guarded(|| read(reader().model_for_proto_model(&cut(&file, &[behind]))?)).ok()
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

    fn floats(&mut self, float_data: Vec<f32>) -> String {
        let (data_type, dims) = (Float as i32, vec![float_data.len() as i64]);
        self.tensor(TensorProto { data_type, dims, float_data, ..TensorProto::default() })
    }

    fn matrix(&mut self, sizes: [usize; 2], float_data: Vec<f32>) -> String {
        let (data_type, dims) = (Float as i32, sizes.map(|size| size as i64).to_vec());
        self.tensor(TensorProto { data_type, dims, float_data, ..TensorProto::default() })
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

fn is_backwards(node: &NodeProto) -> bool {
    node.attribute
        .iter()
        .any(|attribute| attribute.name == "direction" && attribute.s == b"reverse")
}

/// Recurrent units that go backwards as ones that go forwards over a history that is turned round.
fn turned(parts: &mut Parts<'_>) -> Option<()> {
    // Lengths would be of the turned history.
    if parts.input(4).is_some() || parts.whole("layout") != 0 {
        return None;
    }
    let history = parts.backwards(&parts.input(0)?, 0);
    let all = parts.name("all", 0);
    let mut unit = parts.node.clone();
    unit.attribute.retain(|attribute| attribute.name != "direction");
    *unit.input.first_mut()? = history;
    if parts.is_wanted(0) {
        *unit.output.first_mut()? = all.clone();
    }
    parts.nodes.push(unit);
    let all = parts.backwards(&all, 0);
    parts.give(0, &all)
}

/// The axes of heads and of places exchanged.
const HEADS_FIRST: [i64; 4] = [0, 2, 1, 3];

/// Attention of opset 23 and later as products and a softmax.
fn attention(parts: &mut Parts<'_>) -> Option<()> {
    let softcap = parts.attribute("softcap").map_or(0.0, |softcap| softcap.f);
    let past = [4, 5].map(|slot| parts.input(slot));
    let is_causal = parts.whole("is_causal") != 0;
    let is_continued = past.iter().any(Option::is_some);
    if softcap != 0.0 || parts.is_wanted(3) || parts.input(6).is_some() || is_causal && is_continued
    {
        return None;
    }
    let [query, key, value] = [(0, "q_num_heads"), (1, "kv_num_heads"), (2, "kv_num_heads")]
        .map(|(slot, heads)| heads_first(parts, slot, heads));
    let ((query, queries), (key, keys), (value, values)) = (query?, key?, value?);
    let (key, rows) = continued(parts, key, keys[2], past[0].as_deref(), 1)?;
    let (value, _) = continued(parts, value, values[2], past[1].as_deref(), 2)?;
    let key = repeated(parts, key, [keys[0], keys[1], rows, keys[3]], queries[1])?;
    let value = repeated(parts, value, [values[0], values[1], rows, values[3]], queries[1])?;
    let key = parts.transposed(&key, &[0, 1, 3, 2]);
    let scores = parts.add("MatMul", &[&query, &key]);
    let scale = parts.attribute("scale").map(|scale| scale.f);
    let scale = parts.number(scale.unwrap_or_else(|| (queries[3] as f32).sqrt().recip()));
    let mut scores = parts.add("Mul", &[&scores, &scale]);
    let mut visible = None;
    if is_causal {
        let before = (0..queries[2]).flat_map(|query| (0..rows).map(move |row| row <= query));
        visible = Some(parts.truths(vec![queries[2], rows], before));
    }
    if let Some(mask) = parts.input(3) {
        let (kind, sizes) = parts.fact(&mask)?;
        // A mask that is shorter than the rows would leave out the others.
        sizes.last().filter(|size| **size == rows)?;
        if kind == DatumType::Bool {
            visible = Some(match visible {
                Some(before) => parts.add("And", &[&mask, &before]),
                None => mask,
            });
        } else {
            scores = parts.add("Add", &[&scores, &mask]);
        }
    }
    let shares = shares(parts, &scores, visible.as_deref());
    let mut result = parts.add("MatMul", &[&shares, &value]);
    if parts.attribute("q_num_heads").is_some() {
        let behind = parts.transposed(&result, &HEADS_FIRST);
        result = parts.reshaped(&behind, &[queries[0], queries[2], -1]);
    }
    parts.give(0, &result)
}

/// An input as rows of every head, and its four sizes.
fn heads_first(parts: &mut Parts<'_>, slot: usize, heads: &str) -> Option<(String, [i64; 4])> {
    let x = parts.input(slot)?;
    match *parts.fact(&x)?.1 {
        [batch, heads, rows, width] => Some((x, [batch, heads, rows, width])),
        [batch, rows, width] => {
            let heads = parts.attribute(heads)?.i;
            let x = parts.reshaped(&x, &[batch, rows, heads, width.checked_div(heads)?]);
            Some((parts.transposed(&x, &HEADS_FIRST), [batch, heads, rows, width / heads]))
        }
        _ => None,
    }
}

/// Rows behind those of earlier steps, which are an output too; and how many there are.
fn continued(
    parts: &mut Parts<'_>,
    x: String,
    rows: i64,
    past: Option<&str>,
    slot: usize,
) -> Option<(String, i64)> {
    let Some(past) = past else {
        parts.give(slot, &x)?;
        return Some((x, rows));
    };
    let before = *parts.fact(past)?.1.get(2)?;
    let all = parts.add_with("Concat", &[past, &x], vec![whole("axis", 2)]);
    parts.give(slot, &all)?;
    Some((all, before + rows))
}

/// Heads that several queries share, once for each.
fn repeated(parts: &mut Parts<'_>, x: String, sizes: [i64; 4], heads: i64) -> Option<String> {
    let [batch, own, rows, width] = sizes;
    let times = heads.checked_div(own)?;
    if times == 1 {
        return Some(x);
    }
    let apart = parts.reshaped(&x, &[batch, own, 1, rows, width]);
    let sizes = parts.row(&[batch, own, times, rows, width]);
    let all = parts.add("Expand", &[&apart, &sizes]);
    Some(parts.reshaped(&all, &[batch, heads, rows, width]))
}

/// What every row is weighed by; a query that sees no row weighs none.
fn shares(parts: &mut Parts<'_>, scores: &str, visible: Option<&str>) -> String {
    let axis = || vec![whole("axis", -1)];
    let Some(visible) = visible else { return parts.add_with("Softmax", &[scores], axis()) };
    let [least, none] = [f32::MIN, 0.0].map(|number| parts.number(number));
    let scores = parts.add("Where", &[visible, scores, &least]);
    let shares = parts.add_with("Softmax", &[&scores], axis());
    parts.add("Where", &[visible, &shares, &none])
}
