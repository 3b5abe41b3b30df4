//! What nobody refuses and somebody should know: a file that is read as it stands, and may not be what was meant.

use tract_onnx::pb::{ModelProto, NodeProto};
use tract_onnx::prelude::*;

use super::FlatGraph;
use super::nodes::{Nodes, cut};
use super::values::reader;
use crate::graph::guarded;

/// Sentences about a file, in the order in which they matter.
pub(crate) fn remarks(graph: &FlatGraph) -> Vec<String> {
    let mut remarks = forgetful_units(&graph.file);
    remarks.extend(fixed_batch(graph));
    remarks
}

/// Recurrent units of one step whose memory does not come in: whatever they keep is gone at the next decision.
fn forgetful_units(file: &ModelProto) -> Vec<String> {
    let Some(graph) = &file.graph else { return Vec::new() };
    let nodes = Nodes::of(graph);
    let comes_in = |name: &str| {
        let behind = nodes.behind([name]);
        graph.input.iter().any(|input| behind.contains(&input.name))
    };
    let forgets = |node: &&NodeProto| {
        let initial = node.input.get(5).filter(|name| !name.is_empty());
        ["RNN", "GRU", "LSTM"].contains(&node.op_type.as_str())
            && initial.is_none_or(|name| !comes_in(name))
            && guarded(|| steps(file, node)) == Ok(1)
    };
    let units = graph.node.iter().filter(forgets);
    let remark = |unit: &NodeProto| {
        format!(
            "{} `{}` starts from the same state at every call, and remembers nothing: export its state as an input and \
             an output, if it should",
            unit.op_type, unit.name
        )
    };
    units.map(remark).collect()
}

/// How long the history of a recurrent unit is.
fn steps(file: &ModelProto, node: &NodeProto) -> TractResult<i64> {
    let history = node.input.first().map_or("", String::as_str);
    // An output that is an input as well would lose its sizes.
    let behind = format!("{history}.behind");
    let mut file = file.clone();
    file.graph.get_or_insert_default().node.push(NodeProto {
        op_type: "Identity".into(),
        input: vec![history.to_owned()],
        output: vec![behind.clone()],
        ..Default::default()
    });
    let model = reader().model_for_proto_model(&cut(&file, &[behind]))?.into_typed()?;
    let batch_first = node.attribute.iter().any(|a| a.name == "layout" && a.i == 1);
    Ok(model.output_fact(0)?.shape[usize::from(batch_first)].to_i64()?)
}

/// A batch that the file fixes at more than one: every decision computes all of it.
fn fixed_batch(graph: &FlatGraph) -> Option<String> {
    let facts = &graph.interface.facts;
    let inputs = facts.inputs.iter().map(|input| &input.shape);
    let mut shapes = inputs.chain(facts.outputs.iter().map(|output| &output.shape));
    let batch = *facts.inputs.first()?.shape.first()?;
    let is_batch =
        batch > 1 && shapes.all(|shape| shape.len() > 1 && shape.first() == Some(&batch));
    is_batch.then(|| {
        format!(
            "all inputs and outputs are {batch} rows: if that is the batch that it was exported with, every decision \
             computes {batch} of them; export it with one row or an open size"
        )
    })
}
