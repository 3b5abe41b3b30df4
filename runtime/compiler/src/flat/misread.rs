//! What a file asks for and tract passes over: such a policy would be computed as another one.

use sortie_plans::CompileError;
use tract_onnx::pb::{AttributeProto, GraphProto, ModelProto, NodeProto};
use tract_onnx::prelude::*;

use super::nodes::cut;
use super::values::reader;
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
