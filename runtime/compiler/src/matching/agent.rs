//! The masked-attention utility network (dissertation section 7.3).

use sortie_core::internal::ops::Targets;
use sortie_plans::{CompileError, Layer, Matrix};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::logic::Iff;
use tract_onnx::tract_core::ops::nn::{Reduce, Reducer, Softmax};
use tract_onnx::tract_hir::internal::DimLike;

use super::gru::{
    Found, GruLayers, bias_values, match_gru, match_layer, match_product, match_product_of_two,
    match_scale, match_sum, own_row, terms,
};
use super::pointing::match_pointing;
use crate::graph::{Graph, TeamRoles};

/// Logits of masked entities must be at least this small: e to that power is zero.
const BLOCKED: f32 = -1.0e9;

/// The layers of an agent network, all matrices `[inputs, outputs]`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AgentLayers {
    /// Entities to embeddings.
    pub(crate) embed: Layer,
    pub(crate) heads: usize,
    /// Own embedding to queries, the scale of the scores included.
    pub(crate) query: Layer,
    /// Embeddings to keys.
    pub(crate) key: Matrix,
    /// Embeddings to values.
    pub(crate) value: Matrix,
    /// Heads to the attention's output.
    pub(crate) output: Layer,
    /// Own embedding to what is added to the output, before its ReLU.
    pub(crate) skip: Option<Matrix>,
    /// What follows the attention, in order. Where the head points, its last layer gives the utilities of actions that aim
    /// at nobody, then the vector that points: what is for embeddings, then what is for the features of pairs.
    pub(crate) steps: Vec<Step>,
    /// Which actions aim at which entities, where the head points.
    pub(crate) targets: Option<Targets>,
}

/// What is done to one vector.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Step {
    Dense(Layer),
    Gru(Box<GruLayers>),
}

/// What attention asks: whose row forms the query, and what it may see.
#[derive(Clone, Copy, Debug)]
struct Question {
    /// The number of the own row.
    own: OutletId,
    visible: OutletId,
}

/// Matches an agent's network, from the output backwards.
pub(crate) fn match_agent(graph: &Graph) -> Result<AgentLayers, CompileError> {
    let roles = graph.agent_roles()?;
    let input = |index| graph.input(index).ok_or_else(no_output);
    let question = Question { own: input(roles.self_index)?, visible: input(roles.visible)? };
    let (found, embedding) = match_network(graph, question)?;
    let embed = match_layer(graph, embedding)?;
    if graph.source(embed.input) != input(roles.entities)? {
        return Err(graph.unsupported(embed.input, "attention reads one layer over the entities"));
    }
    Ok(found(embed.layer))
}

/// Matches attention of the own row's query and dense layers, without what embeds the rows: that is
/// matched by the caller, at the outlet of the embedding.
fn match_network(
    graph: &Graph,
    question: Question,
) -> Result<(impl FnOnce(Layer) -> AgentLayers + use<>, OutletId), CompileError> {
    let mut steps = Vec::new();
    let mut outlet = graph.answer;
    let pointing = match_pointing(graph, outlet, question.visible)?;
    if let Some(found) = &pointing {
        steps.push(Step::Dense(found.head.clone()));
        outlet = found.input;
    }
    let (output, mixed, skip) = loop {
        if let Some(found) = match_gru(graph, outlet)? {
            steps.push(Step::Gru(Box::new(found.layers)));
            outlet = found.input;
            continue;
        }
        if let Some((found, skip)) = match_skip(graph, outlet, question.own) {
            break (found.layer, found.input, Some(skip));
        }
        let found = match_layer(graph, outlet)?;
        if match_product_of_two(graph, found.input).is_some() {
            break (found.layer, found.input, None);
        }
        steps.push(Step::Dense(found.layer));
        outlet = found.input;
    };
    steps.reverse();
    let (weights, value) = match_mixed(graph, mixed)?;
    let (scores, heads) = match_weights(graph, weights, question.visible)?;
    let (query, key, embedding) = match_scores(graph, scores, question.own)?;
    let value = match_projection(graph, value, embedding)?;
    if let Some(skip) = skip.as_ref().filter(|skip| skip.embedding != graph.source(embedding)) {
        return Err(graph.unsupported(skip.embedding, "a skip takes the row that forms the query"));
    }
    let skip = skip.map(|skip| skip.matrix);
    if let Some(found) = pointing.as_ref().filter(|it| it.embedding != graph.source(embedding)) {
        return Err(graph.unsupported(found.embedding, "a head points at what attention reads"));
    }
    let targets = pointing.map(|pointing| pointing.targets);
    let with =
        move |embed| AgentLayers { embed, heads, query, key, value, output, skip, steps, targets };
    Ok((with, embedding))
}

/// A product of the own row that is added to the attention's output.
struct Skip {
    matrix: Matrix,
    /// What the row is taken from.
    embedding: OutletId,
}

/// Matches `relu(mixed W_o + own W_s + b)`: the layer of what attention mixed, and what passes it by.
fn match_skip(graph: &Graph, outlet: OutletId, own: OutletId) -> Option<(Found, Skip)> {
    let [a, b] = match_sum(graph, outlet)?;
    let skip = |found: &Found| own_row(graph, found.input, own);
    let (found, matrix, embedding) = match (skip(&a), skip(&b)) {
        (None, Some(embedding)) => (a, b.layer.matrix, embedding),
        (Some(embedding), None) => (b, a.layer.matrix, embedding),
        _ => return None,
    };
    match_product_of_two(graph, found.input)?;
    Some((found, Skip { matrix, embedding }))
}

pub(super) fn no_output() -> CompileError {
    CompileError::Unreadable { reason: "the graph lacks an input or output".to_owned() }
}

/// `weights · values`: which operand is which.
pub(super) fn match_mixed(
    graph: &Graph,
    mixed: OutletId,
) -> Result<(OutletId, OutletId), CompileError> {
    match match_product_of_two(graph, mixed) {
        Some([a, b]) if graph.node(a).op_is::<Iff>() => Ok((a, b)),
        Some([a, b]) if graph.node(b).op_is::<Iff>() => Ok((b, a)),
        _ => {
            Err(graph
                .unsupported(mixed, "attention multiplies Where(visible, weights, 0) by values"))
        }
    }
}

/// `Where(visible, softmax(Where(visible, logits, -1e30)), 0)`: the logits, and the number of heads.
pub(super) fn match_weights(
    graph: &Graph,
    weights: OutletId,
    mask: OutletId,
) -> Result<(OutletId, usize), CompileError> {
    const HINT: &str =
        "masked attention is Where(visible, Softmax(Where(visible, logits, -1e30)), 0)";
    let masked = |outlet: OutletId| match graph.node(outlet).inputs.as_slice() {
        &[visible, value, other] if graph.node(outlet).op_is::<Iff>() => {
            let asks = graph.source(visible) == mask;
            let other = asks.then(|| graph.uniform(other)).flatten();
            other.map(|other| (value, other))
        }
        _ => None,
    };
    let unsupported = |outlet| graph.unsupported(outlet, HINT);
    let (softmax, nothing) = masked(weights).ok_or_else(|| unsupported(weights))?;
    let node = graph.node(softmax);
    let &[logits] = node.inputs.as_slice() else { return Err(unsupported(softmax)) };
    let (logits, blocked) = masked(logits).ok_or_else(|| unsupported(logits))?;
    if !node.op_is::<Softmax>() || nothing != 0.0 || blocked > BLOCKED {
        return Err(unsupported(softmax));
    }
    let fact = graph.model.outlet_fact(graph.source(softmax)).map_err(|_| unsupported(softmax))?;
    Ok((logits, fact.shape.iter().filter_map(|dim| dim.to_usize().ok()).product()))
}

/// `scale · (q · k)`: the query with the scale folded in, the keys, and the embedding of both.
fn match_scores(
    graph: &Graph,
    scores: OutletId,
    own_index: OutletId,
) -> Result<(Layer, Matrix, OutletId), CompileError> {
    const HINT: &str = "scores are the product of the own row's query and of keys";
    let (product, scale) = match_scale(graph, scores);
    let unsupported = || graph.unsupported(product, HINT);
    let [a, b] = match_product_of_two(graph, product).ok_or_else(unsupported)?;
    let [(a, scale_a), (b, scale_b)] = [match_scale(graph, a), match_scale(graph, b)];
    let [a, b] = [match_layer(graph, a)?, match_layer(graph, b)?];
    let own = |found: &Found| own_row(graph, found.input, own_index);
    let (query, embedding, key) = match (own(&a), own(&b)) {
        (Some(embedding), None) => (a, embedding, b),
        (None, Some(embedding)) => (b, embedding, a),
        _ => return Err(unsupported()),
    };
    if graph.source(key.input) != graph.source(embedding) || query.layer.relu || key.layer.relu {
        return Err(unsupported());
    }
    let mut query = query.layer;
    let scale = scale * scale_a * scale_b;
    query.matrix.values.iter_mut().chain(&mut query.bias).for_each(|value| *value *= scale);
    // A bias of the keys adds the same to every score of a head and drops out of the softmax.
    Ok((query, key.layer.matrix, embedding))
}

fn match_projection(
    graph: &Graph,
    outlet: OutletId,
    embedding: OutletId,
) -> Result<Matrix, CompileError> {
    let found = match_layer(graph, outlet)?;
    if found.layer.relu || found.has_bias || graph.source(found.input) != embedding {
        return Err(
            graph.unsupported(outlet, "values are the embeddings times a matrix, without bias")
        );
    }
    Ok(found.layer.matrix)
}

/// Matches an allocator's network. Its rows are features, own flag, team flag and relation.
pub(crate) fn match_team_value(graph: &Graph) -> Result<AgentLayers, CompileError> {
    let roles = graph.team_roles()?;
    let (found, embedding) = match_network(graph, question(graph, roles)?)?;
    Ok(found(match_embedding(graph, roles, embedding)?))
}

/// Finds the first row of the subtask, `ArgMax(in_task)`, and the mask `present and (is_agent or open)`.
fn question(graph: &Graph, roles: TeamRoles) -> Result<Question, CompileError> {
    let outlets = || graph.model.nodes.iter().map(|node| OutletId::new(node.id, 0));
    let is = |outlet: OutletId, input: usize| Some(graph.source(outlet)) == graph.input(input);
    let own = outlets().find(|outlet| {
        let node = graph.model.node(outlet.node);
        let first = |reduce: &Reduce| {
            reduce.reducer == Reducer::ArgMax(false) && reduce.axes.as_slice() == [0]
        };
        node.op_as::<Reduce>().is_some_and(first)
            && node.inputs.iter().all(|input| is(uncast(graph, *input), roles.in_task))
    });
    let both = |outlet: OutletId, operator: &str| -> Option<[OutletId; 2]> {
        let node = graph.node(outlet);
        let binary = node.op_as::<TypedBinOp>()?;
        let &[a, b] = node.inputs.as_slice() else { return None };
        (binary.0.name() == operator).then_some([a, b])
    };
    let either = |[a, b]: [OutletId; 2]| {
        is(a, roles.is_agent) && is(b, roles.open) || is(b, roles.is_agent) && is(a, roles.open)
    };
    let visible = outlets().find(|outlet| {
        let Some([a, b]) = both(*outlet, "And") else { return false };
        is(a, roles.present) && both(b, "Or").is_some_and(either)
            || is(b, roles.present) && both(a, "Or").is_some_and(either)
    });
    const OWN: &str = "the query is the row at ArgMax(in_task)";
    const VISIBLE: &str = "attention sees present and (is_agent or open)";
    let last = graph.model.outputs.last().copied().unwrap_or(OutletId::new(0, 0));
    Ok(Question {
        own: own.ok_or_else(|| graph.unsupported(last, OWN))?,
        visible: visible.ok_or_else(|| graph.unsupported(last, VISIBLE))?,
    })
}

/// Matches `relu(x W + b)` over the joined columns, which tract splits into a product for each part.
fn match_embedding(
    graph: &Graph,
    roles: TeamRoles,
    embedding: OutletId,
) -> Result<Layer, CompileError> {
    const HINT: &str = "rows are entities, in_task, team and relation side by side, in one layer";
    let relu = graph.with_constant(embedding, "Max");
    let relu = relu.filter(|[_, low]| graph.uniform(*low) == Some(0.0));
    let mut sum = relu.map_or(embedding, |[sum, _]| sum);
    let unsupported = |outlet| graph.unsupported(outlet, HINT);
    let mut bias = None;
    if let Some([rest, constant]) = graph.with_constant(sum, "Add") {
        (sum, bias) = (rest, Some(constant));
    }
    let wanted = [roles.entities, roles.in_task, roles.team, roles.relation];
    let mut parts: [Option<Matrix>; 4] = Default::default();
    for product in terms(graph, sum) {
        let (matrix, input) = match_product(graph, product)?;
        let input = graph.source(uncast(graph, input));
        let place = wanted.iter().position(|wanted| graph.input(*wanted) == Some(input));
        let part = place.and_then(|place| parts.get_mut(place)).filter(|part| part.is_none());
        *part.ok_or_else(|| unsupported(product))? = Some(matrix);
    }
    // Of a relation without columns there is no product.
    let needed = if roles.relations > 0 { 4 } else { 3 };
    let parts: Option<Vec<Matrix>> = parts.into_iter().take(needed).collect();
    let parts = parts.ok_or_else(|| unsupported(sum))?;
    let outputs = parts.first().map_or(0, |part| part.outputs);
    let inputs = parts.iter().map(|part| part.inputs).sum();
    if parts.iter().any(|part| part.outputs != outputs) || inputs != graph.columns {
        return Err(unsupported(sum));
    }
    let values = parts.into_iter().flat_map(|part| part.values).collect();
    let bias = match bias {
        Some(bias) => bias_values(graph, bias, outputs).ok_or_else(|| unsupported(sum))?,
        None => vec![0.0; outputs],
    };
    Ok(Layer { matrix: Matrix { inputs, outputs, values }, bias, relu: relu.is_some() })
}

/// What a cast was applied to.
pub(super) fn uncast(graph: &Graph, outlet: OutletId) -> OutletId {
    let node = graph.node(outlet);
    match node.inputs.as_slice() {
        &[input] if node.op_is::<Cast>() => input,
        _ => outlet,
    }
}
