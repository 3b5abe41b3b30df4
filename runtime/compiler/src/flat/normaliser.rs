//! Whether a network normalises what it sees by itself, and by what: numbers drawn around other means tell little of it.

use sortie_core::plan::Normaliser;
use sortie_plans::{InputRole, PolicyFacts, PolicyInput};
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto};

use super::FlatGraph;
use super::nodes::{Nodes, cut};
use crate::graph::guarded;
use crate::reference::{Reference, Tensor};

/// Operators that bring an observation on as it is, in other sizes or beside others.
const CARRIERS: [&str; 12] = [
    "Identity",
    "Cast",
    "Reshape",
    "Flatten",
    "Squeeze",
    "Unsqueeze",
    "Transpose",
    "Concat",
    "Slice",
    "Split",
    "Gather",
    "Clip",
];

/// Whether a policy normalises what it sees: who does it besides, or nobody, is no error that anybody sees.
pub(crate) fn normaliser(graph: &FlatGraph) -> Normaliser {
    let mut inputs = graph.interface.facts.inputs.iter();
    match inputs.any(|input| normalised(&graph.source, input).is_some()) {
        true => Normaliser::File,
        false => Normaliser::None,
    }
}

/// The value that an observation is once it is normalised, where that is the first thing that happens to it.
fn normalised(file: &ModelProto, input: &PolicyInput) -> Option<String> {
    let graph = file.graph.as_ref()?;
    let is_seen = matches!(input.role, InputRole::Observation | InputRole::Entities { .. });
    if !input.kind.is_float() || !is_seen {
        return None;
    }
    let (mut waiting, mut left) = (vec![input.name.as_str()], graph.node.len());
    while let Some(value) = waiting.pop() {
        for node in readers(graph, value) {
            if let Some(behind) = behind_normaliser(graph, node) {
                return Some(behind);
            }
            if CARRIERS.contains(&node.op_type.as_str()) && left > 0 {
                left -= 1;
                waiting.extend(node.output.iter().map(String::as_str));
            }
        }
    }
    None
}

fn readers<'g>(graph: &'g GraphProto, value: &str) -> impl Iterator<Item = &'g NodeProto> {
    graph.node.iter().filter(move |node| node.input.iter().any(|input| input == value))
}

/// What comes out of a normaliser that begins with a node: the means go, then a division by the deviations follows. What is
/// divided at once, as pictures are by 255, only has another unit.
fn behind_normaliser(graph: &GraphProto, node: &NodeProto) -> Option<String> {
    let nodes = Nodes::of(graph);
    let is_constant = |name: &String| {
        let behind = nodes.behind([name.as_str()]);
        !graph.input.iter().any(|input| behind.contains(&input.name))
    };
    let is_by_constant = |node: &NodeProto, by: [&str; 2]| {
        by.contains(&&*node.op_type) && node.input.iter().any(is_constant)
    };
    let output = node.output.first()?;
    if ["Scaler", "BatchNormalization"].contains(&&*node.op_type) {
        return Some(output.clone());
    }
    if !is_by_constant(node, ["Sub", "Add"]) {
        return None;
    }
    let scales = readers(graph, output).find(|next| is_by_constant(next, ["Div", "Mul"]));
    scales?.output.first().cloned()
}

/// Notes mean and deviation of every number of the observations that the file normalises.
pub(super) fn note_normals(file: &ModelProto, facts: &mut PolicyFacts) {
    for input in &mut facts.inputs {
        let behind = normalised(file, input);
        input.normals = behind.and_then(|behind| normals(file, input, behind)).unwrap_or_default();
    }
}

/// Mean and deviation of every number, where each goes through a line of its own.
fn normals(file: &ModelProto, input: &PolicyInput, behind: String) -> Option<Vec<[f32; 2]>> {
    let file = cut(file, std::slice::from_ref(&behind));
    // What stands beside it would have to be known.
    if file.graph.as_ref()?.input.len() != 1 {
        return None;
    }
    let wanted = [behind];
    let run = || {
        let reference = Reference::new(&file).map_err(tract_onnx::prelude::TractError::msg)?;
        let at = |number: &dyn Fn(usize) -> f64| {
            let numbers = (0..input.length()).map(number).collect();
            let tensor = Tensor::real(input.shape.clone(), numbers);
            let found = reference.run([(input.name.clone(), tensor)], &wanted, None);
            found.map_err(tract_onnx::prelude::TractError::msg)
        };
        Ok([at(&|_| 0.0)?, at(&|_| 1.0)?, at(&|place| place as f64)?])
    };
    let found = guarded(run).ok()?.map(|found| found.first().map(Tensor::to_reals));
    let [Some(zeros), Some(ones), Some(places)] = found else { return None };
    if zeros.len() != input.length() {
        return None;
    }
    let line = |(place, ((zero, one), there)): (usize, ((&f64, &f64), &f64))| {
        let slope = one - zero;
        let is_line = (zero + slope * place as f64 - there).abs() <= 1.0e-6 * (1.0 + there.abs());
        let numbers = [-zero / slope, 1.0 / slope.abs()].map(|number| number as f32);
        (is_line && numbers.iter().all(|number| number.is_finite())).then_some(numbers)
    };
    zeros.iter().zip(&ones).zip(&places).enumerate().map(line).collect()
}
