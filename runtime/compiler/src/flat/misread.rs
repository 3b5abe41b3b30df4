//! What a file asks for and tract passes over: such a policy would be computed, and proved, as another one.

use sortie_plans::CompileError;
use tract_onnx::pb::{AttributeProto, GraphProto, NodeProto};

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
            let alpha = attribute("alpha").filter(|alpha| alpha.f != 1.0);
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
