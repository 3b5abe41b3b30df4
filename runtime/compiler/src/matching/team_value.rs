//! The team-value network of an allocator: an agent's layers behind joined columns.

use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::nn::{Reduce, Reducer};

use super::agent::{AgentLayers, Question, match_network};
use super::linear::{bias_values, match_product, terms};
use crate::graph::{Graph, TeamRoles};
use sortie_plans::CompileError;
use sortie_plans::{Layer, Matrix};

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
    let parts: Option<Vec<Matrix>> = parts.into_iter().collect();
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
