//! The head that points: utilities of actions that are aimed at entities.

use sortie_core::internal::ops::Targets;
use sortie_plans::{CompileError, Layer, Matrix};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{Gather, TypedConcat};
use tract_onnx::tract_core::ops::logic::Iff;

use super::gru::{match_layer, match_product_of_two};
use crate::graph::Graph;

const HINT: &str =
    "a head that points is Concat(untargeted, Where(visible[targets], q · embedding[targets], 0))";

/// A pointing head found in the graph.
pub(super) struct Pointing {
    /// The utilities of actions that aim at nobody, then the vector that points, of one input.
    pub(super) head: Layer,
    pub(super) input: OutletId,
    /// What it points at.
    pub(super) embedding: OutletId,
    pub(super) targets: Targets,
}

/// Matches a pointing head; none where the answer is no joined one.
pub(super) fn match_pointing(
    graph: &Graph,
    answer: OutletId,
    visible: OutletId,
) -> Result<Option<Pointing>, CompileError> {
    let node = graph.node(answer);
    let &[untargeted, aimed] = node.inputs.as_slice() else { return Ok(None) };
    if !node.op_is::<TypedConcat>() {
        return Ok(None);
    }
    let unsupported = |outlet| graph.unsupported(outlet, HINT);
    let (first_entity, count, scores) =
        match_aimed(graph, aimed, visible).ok_or_else(|| unsupported(aimed))?;
    let [a, b] = match_product_of_two(graph, scores).ok_or_else(|| unsupported(scores))?;
    let (query, rows) = match (gathered(graph, a), gathered(graph, b)) {
        (None, Some(rows)) => (a, rows),
        (Some(rows), None) => (b, rows),
        _ => return Err(unsupported(scores)),
    };
    let (embedding, first, rows) = rows;
    let [head, query] = [match_layer(graph, untargeted)?, match_layer(graph, query)?];
    let fits = (first, rows) == (first_entity, count)
        && graph.source(head.input) == graph.source(query.input)
        && !head.layer.relu
        && !query.layer.relu;
    if !fits {
        return Err(unsupported(scores));
    }
    let targets = Targets {
        untargeted: head.layer.matrix.outputs as u16,
        first_entity: first_entity as u16,
        count: count as u16,
        width: query.layer.matrix.outputs as u16,
    };
    let input = head.input;
    Ok(Some(Pointing { head: beside(&head.layer, &query.layer), input, embedding, targets }))
}

/// One more than the last entity that an action of an agent aims at; 0 where none does.
pub(crate) fn aimed_at(graph: &Graph) -> Result<usize, CompileError> {
    let visible = graph.input(graph.agent_roles()?.visible);
    let visible = visible.ok_or_else(|| graph.unsupported(graph.answer, HINT))?;
    let found = match_pointing(graph, graph.answer, visible)?;
    let end = |it: Pointing| usize::from(it.targets.first_entity) + usize::from(it.targets.count);
    Ok(found.map_or(0, end))
}

/// `Where(visible[targets], scores, 0)`: the first target, how many there are, and the scores.
fn match_aimed(
    graph: &Graph,
    aimed: OutletId,
    visible: OutletId,
) -> Option<(usize, usize, OutletId)> {
    let node = graph.node(aimed);
    let &[seen, scores, nothing] = node.inputs.as_slice() else { return None };
    let (mask, first, count) = gathered(graph, seen)?;
    let fits = node.op_is::<Iff>() && mask == visible && graph.uniform(nothing) == Some(0.0);
    fits.then_some((first, count, scores))
}

/// Rows that follow each other, of what, the first and how many.
fn gathered(graph: &Graph, outlet: OutletId) -> Option<(OutletId, usize, usize)> {
    let node = graph.node(outlet);
    node.op_as::<Gather>().filter(|gather| gather.axis == 0)?;
    let &[rows, indices] = node.inputs.as_slice() else { return None };
    let indices = graph.model.outlet_fact(indices).ok()?.konst.clone()?;
    let indices = indices.cast_to::<i64>().ok()?;
    let indices = indices.to_plain_array_view::<i64>().ok()?;
    let first = usize::try_from(*indices.first()?).ok()?;
    let in_order = (first as i64..).zip(indices.iter()).all(|(want, got)| want == *got);
    in_order.then_some((graph.source(rows), first, indices.len()))
}

/// Two layers of one input as one, whose outputs stand one behind the other.
fn beside(first: &Layer, second: &Layer) -> Layer {
    let [a, b] = [first, second].map(|layer| &layer.matrix);
    let rows = a.values.chunks_exact(a.outputs).zip(b.values.chunks_exact(b.outputs));
    let values = rows.flat_map(|(a, b)| a.iter().chain(b).copied()).collect();
    let matrix = Matrix { inputs: a.inputs, outputs: a.outputs + b.outputs, values };
    Layer { matrix, bias: [&*first.bias, &*second.bias].concat(), relu: false }
}
