//! What nobody refuses and somebody should know: a file that is read as it stands, and may not be what was meant.

use std::collections::BTreeMap;

use tract_onnx::pb::{ModelProto, NodeProto};
use tract_onnx::prelude::*;

use super::FlatGraph;
use super::nodes::{Nodes, cut};
use super::selection::words;
use super::values::reader;
use crate::graph::guarded;

/// Sentences about a file, in the order in which they matter.
pub(crate) fn remarks(graph: &FlatGraph) -> Vec<String> {
    let mut remarks = forgetful_units(&graph.file);
    remarks.extend(fixed_batch(graph));
    remarks.extend(taken_for_batch(graph));
    remarks
}

/// Words of names that count decisions; whatever else leads the sizes of an input may be what the policy looks at.
const COUNTS: [&str; 10] =
    ["batch", "batches", "batchsize", "env", "envs", "samples", "unk", "dynamic", "dim", "none"];
/// Names that say as much by themselves.
const COUNTS_ALONE: [&str; 5] = ["n", "b", "bs", "s", "u"];

/// Named sizes that are one because they come first, as a batch does, though their names do not say that they are one.
fn taken_for_batch(graph: &FlatGraph) -> Vec<String> {
    let is_needed =
        |name: &String| graph.interface.facts.inputs.iter().any(|input| input.name == *name);
    let taken = graph.batches.iter().filter(|(_, input)| is_needed(input));
    let taken: BTreeMap<_, _> =
        taken.filter(|(size, _)| !counts_decisions(size)).cloned().collect();
    let remark = |(size, input): (String, String)| {
        format!(
            "the size `{size}`, which comes first in `{input}`, is taken for a batch of one; if it counts what the policy \
             looks at in one decision, say how many: `--size {size}=7`"
        )
    };
    taken.into_iter().map(remark).collect()
}

fn counts_decisions(name: &str) -> bool {
    let words: Vec<String> = words(name)
        .into_iter()
        .filter(|word| !word.chars().all(|letter| letter.is_ascii_digit()))
        .collect();
    match &words[..] {
        [] => true,
        [one] if COUNTS_ALONE.contains(&one.as_str()) => true,
        words => words.iter().any(|word| COUNTS.contains(&word.as_str())),
    }
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
    let flags = facts.inputs.iter().map(|input| format!("--size {}.0=1", input.name));
    is_batch.then(|| {
        format!(
            "all inputs and outputs are {batch} rows: if that is the batch that it was exported with, every decision \
             computes {batch} of them; try `{}`, or export it with one row or an open size",
            flags.collect::<Vec<_>>().join(" ")
        )
    })
}
