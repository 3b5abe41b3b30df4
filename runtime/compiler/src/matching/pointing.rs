//! The head that points: utilities of actions that are aimed at entities.

use std::ops::Range;

use sortie_core::internal::ops::Targets;
use sortie_plans::{CompileError, Layer, Matrix};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{Gather, Slice, TypedConcat};
use tract_onnx::tract_core::ops::logic::Iff;
use tract_onnx::tract_hir::internal::DimLike;

use super::gru::{Found, match_layer, match_product_of_two, own_row, terms};
use crate::graph::Graph;

const HINT: &str = "a head that points is Concat(untargeted, Where(visible[targets], scores, 0)), with scores \
     q · embedding[targets], or that and w · Reshape(entities[self_index, columns])";

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
    let Scores { query, rows: (embedding, first, rows), pairs } =
        match_scores(graph, scores).ok_or_else(|| unsupported(scores))?;
    let head = match_layer(graph, untargeted)?;
    let mut layers = vec![match_layer(graph, query)?];
    let (mut first_pair, mut pair_features) = (0, 0);
    if let Some((weights, columns)) = pairs {
        let weights = match_layer(graph, weights)?;
        (first_pair, pair_features) = (columns.start, weights.layer.matrix.outputs);
        if columns.len() != count * pair_features {
            return Err(unsupported(scores));
        }
        layers.push(weights);
    }
    let is_beside =
        |layer: &Found| graph.source(layer.input) == graph.source(head.input) && !layer.layer.relu;
    if (first, rows) != (first_entity, count) || head.layer.relu || !layers.iter().all(is_beside) {
        return Err(unsupported(scores));
    }
    let targets = Targets {
        untargeted: head.layer.matrix.outputs as u16,
        first_entity: first_entity as u16,
        count: count as u16,
        width: layers[0].layer.matrix.outputs as u16,
        first_pair: first_pair as u16,
        pair_features: pair_features as u16,
    };
    let input = head.input;
    let head = layers.iter().fold(head.layer, |head, next| beside(&head, &next.layer));
    Ok(Some(Pointing { head, input, embedding, targets }))
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

/// What the utilities of aimed actions are made of.
struct Scores {
    /// The vector that points.
    query: OutletId,
    /// What it points at, the first and how many.
    rows: (OutletId, usize, usize),
    /// What the features of pairs are multiplied with, and where they stand in the own row.
    pairs: Option<(OutletId, Range<usize>)>,
}

/// `q · embedding[targets]`, or that and `w · Reshape(entities[self_index, columns])`.
fn match_scores(graph: &Graph, scores: OutletId) -> Option<Scores> {
    let products = terms(graph, scores).into_iter().map(|term| match_product_of_two(graph, term));
    let mut products = products.collect::<Option<Vec<_>>>()?;
    let embedded = |[a, b]: [OutletId; 2]| match (gathered(graph, a), gathered(graph, b)) {
        (None, Some(rows)) => Some((a, rows)),
        (Some(rows), None) => Some((b, rows)),
        _ => None,
    };
    let place = products.iter().position(|product| embedded(*product).is_some())?;
    let (query, rows) = embedded(products.swap_remove(place))?;
    let pairs = match *products.as_slice() {
        [] => None,
        [[a, b]] => Some(match (own_columns(graph, a), own_columns(graph, b)) {
            (None, Some(columns)) => (a, columns),
            (Some(columns), None) => (b, columns),
            _ => return None,
        }),
        _ => return None,
    };
    Some(Scores { query, rows, pairs })
}

/// Columns of the row of the agent that decides.
fn own_columns(graph: &Graph, outlet: OutletId) -> Option<Range<usize>> {
    let roles = graph.agent_roles().ok()?;
    let node = graph.node(outlet);
    let slice = node.op_as::<Slice>().filter(|slice| slice.axis == 1)?;
    let (start, end) = (slice.start.to_usize().ok()?, slice.end.to_usize().ok()?);
    let entities = own_row(graph, *node.inputs.first()?, graph.input(roles.self_index)?)?;
    (entities == graph.input(roles.entities)?).then_some(start..end)
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
