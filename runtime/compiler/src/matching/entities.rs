//! Networks over all entities: critics, the trunks of allocators (dissertation sections 2.3 and 5.1).

use sortie_core::internal::ops::Members;
use sortie_plans::{CompileError, Layer};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_core::ops::einsum::EinSum;
use tract_onnx::tract_core::ops::logic::Iff;
use tract_onnx::tract_core::ops::nn::{Reduce, Reducer, Softmax};

use super::agent::{match_mixed, match_weights, no_output, uncast};
use super::gru::{is, match_layer, match_product_of_two, match_scale, with};
use crate::graph::{EntityRoles, Graph};

pub(super) const SAME_ROWS: &str = "values are a layer over the same rows";

/// A network over all entities. Value 0 is the embedding, value i + 1 what step i computes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct EntityLayers {
    /// Entities to embeddings.
    pub(crate) embed: Layer,
    /// What is computed from earlier values, in order.
    pub(crate) steps: Vec<EntityStep>,
    /// The values that the caller reads, in the order of the graph's outputs.
    pub(crate) outputs: Vec<usize>,
}

/// One step of a network over all entities.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum EntityStep {
    /// Attention of every row's query.
    Attend { rows: usize, attention: Box<AllAttention> },
    /// The mean of some rows.
    Mean { rows: usize, members: Members },
    /// The sums of rows by group.
    GroupSum { rows: usize },
    /// A layer on one vector.
    Dense { from: usize, layer: Layer },
}

/// The layers of attention among all entities.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AllAttention {
    pub(crate) heads: usize,
    /// Rows to queries, the scale of the scores included.
    pub(crate) query: Layer,
    /// Rows to keys.
    pub(crate) key: Layer,
    /// Rows to values.
    pub(crate) value: Layer,
    /// Heads to the attention's output.
    pub(crate) output: Layer,
}

/// Matches a network over all entities, from its outputs backwards.
pub(crate) fn match_entities(graph: &Graph) -> Result<EntityLayers, CompileError> {
    let roles = graph.entity_roles()?;
    let mut matcher = Matcher { graph, roles, embed: None, steps: Vec::new(), known: Vec::new() };
    let outputs = graph.model.outputs.iter().map(|output| matcher.output(*output));
    let outputs = outputs.collect::<Result<_, _>>()?;
    let embed = matcher.embed.ok_or_else(no_output)?;
    Ok(EntityLayers { embed, steps: matcher.steps, outputs })
}

struct Matcher<'g> {
    graph: &'g Graph,
    roles: EntityRoles,
    embed: Option<Layer>,
    steps: Vec<EntityStep>,
    /// The values that outlets stand for.
    known: Vec<(OutletId, usize)>,
}

impl Matcher<'_> {
    /// Rows of present entities, sums by group, or one vector.
    fn output(&mut self, outlet: OutletId) -> Result<usize, CompileError> {
        if let Some(rows) = self.graph.shown(outlet, |mask| self.is(mask, Some(self.roles.present)))
        {
            return self.rows(rows);
        }
        match self.group_sum(outlet) {
            Some(rows) => {
                let rows = self.rows(rows)?;
                Ok(self.add(outlet, EntityStep::GroupSum { rows }))
            }
            None => self.vector(outlet),
        }
    }

    /// A row for every entity: the embedding, or attention.
    fn rows(&mut self, outlet: OutletId) -> Result<usize, CompileError> {
        const HINT: &str = "rows are one layer over the entities, or attention among all of them";
        let graph = self.graph;
        if let Some(value) = self.value(outlet) {
            return Ok(value);
        }
        let found = match_layer(graph, outlet)?;
        if self.is(found.input, Some(self.roles.entities)) {
            if self.embed.replace(found.layer).is_some() {
                return Err(graph.unsupported(outlet, "one layer embeds the entities"));
            }
            self.known.push((graph.source(outlet), 0));
            return Ok(0);
        }
        if match_product_of_two(graph, found.input).is_none() {
            return Err(graph.unsupported(outlet, HINT));
        }
        let (weights, values) = match_mixed(graph, found.input)?;
        let present = graph.input(self.roles.present).ok_or_else(no_output)?;
        let (attention, from) =
            match_all_attention(graph, [weights, values], present, found.layer)?;
        let (rows, attention) = (self.rows(from)?, Box::new(attention));
        Ok(self.add(outlet, EntityStep::Attend { rows, attention }))
    }

    /// One vector: the mean of rows, or a layer on another vector.
    fn vector(&mut self, outlet: OutletId) -> Result<usize, CompileError> {
        if let Some(value) = self.value(outlet) {
            return Ok(value);
        }
        if let Some((rows, members)) = self.mean(outlet) {
            let rows = self.rows(rows)?;
            return Ok(self.add(outlet, EntityStep::Mean { rows, members }));
        }
        let found = match_layer(self.graph, outlet)?;
        let from = self.vector(found.input)?;
        Ok(self.add(outlet, EntityStep::Dense { from, layer: found.layer }))
    }

    /// `ReduceSum(Where(members, rows, 0)) / Max(ReduceSum(Cast(counted)), 1)`: the rows, and whose they are. tract
    /// multiplies by the reciprocal.
    fn mean(&self, outlet: OutletId) -> Option<(OutletId, Members)> {
        let is_reciprocal = |operand| is(self.graph, operand, "Recip");
        let [reciprocal, sum] = with(self.graph, outlet, "Mul", is_reciprocal)?;
        let divisor = *self.graph.node(reciprocal).inputs.first()?;
        let [count, _] = self
            .graph
            .with_constant(divisor, "Max")
            .filter(|[_, least]| self.graph.uniform(*least) == Some(1.0))?;
        let counted = uncast(self.graph, self.graph.source(self.graph.sum_of_rows(count)?));
        let sum = self.graph.sum_of_rows(sum)?;
        let (present, is_agent) = (Some(self.roles.present), self.roles.is_agent);
        let present_agents = |mask| {
            let operands = self.graph.operands(mask, "And");
            operands.is_some_and(|[a, b]| {
                self.is(a, present) && self.is(b, is_agent)
                    || self.is(b, present) && self.is(a, is_agent)
            })
        };
        if self.is(counted, present) {
            let rows = self.graph.shown(sum, |mask| self.is(mask, present))?;
            return Some((rows, Members::Present));
        }
        let rows = self.is(counted, is_agent).then(|| self.graph.shown(sum, present_agents))??;
        Some((rows, Members::Agents))
    }

    /// `Cast(groups)ᵀ Where(present, rows, 0)`: the rows.
    fn group_sum(&self, outlet: OutletId) -> Option<OutletId> {
        let [a, b] = match_product_of_two(self.graph, outlet)?;
        let groups = |outlet| {
            let belongs = uncast(self.graph, self.graph.source(outlet));
            self.is(belongs, self.roles.groups)
        };
        let rows = if groups(a) { b } else { Some(a).filter(|_| groups(b))? };
        self.graph.shown(rows, |mask| self.is(mask, Some(self.roles.present)))
    }

    /// Whether an outlet only reshapes this input.
    fn is(&self, outlet: OutletId, input: Option<usize>) -> bool {
        input.and_then(|input| self.graph.input(input)) == Some(self.graph.source(outlet))
    }

    fn value(&self, outlet: OutletId) -> Option<usize> {
        let outlet = self.graph.source(outlet);
        self.known.iter().find(|(known, _)| *known == outlet).map(|(_, value)| *value)
    }

    fn add(&mut self, outlet: OutletId, step: EntityStep) -> usize {
        self.steps.push(step);
        self.known.push((self.graph.source(outlet), self.steps.len()));
        self.steps.len()
    }
}

impl Graph {
    /// `Where(mask, rows, 0)` with a mask that fits: the rows.
    pub(super) fn shown(
        &self,
        outlet: OutletId,
        fits: impl Fn(OutletId) -> bool,
    ) -> Option<OutletId> {
        let node = self.node(outlet);
        let &[mask, rows, nothing] = node.inputs.as_slice() else { return None };
        let nothing = self.uniform(nothing) == Some(0.0);
        (node.op_is::<Iff>() && nothing && fits(mask)).then_some(rows)
    }

    /// What is summed up over the entities.
    pub(super) fn sum_of_rows(&self, outlet: OutletId) -> Option<OutletId> {
        let node = self.node(outlet);
        let reduce = node.op_as::<Reduce>()?;
        let over_rows = reduce.reducer == Reducer::Sum && reduce.axes.as_slice() == [0];
        node.inputs.first().copied().filter(|_| over_rows)
    }
}

/// The layers of an attention of all rows, and the outlet of the rows.
pub(super) fn match_all_attention(
    graph: &Graph,
    [weights, values]: [OutletId; 2],
    present: OutletId,
    output: Layer,
) -> Result<(AllAttention, OutletId), CompileError> {
    let (logits, heads) = match_weights(graph, weights, present)?;
    let (query, key, rows) = match_all_scores(graph, weights, logits)?;
    let value = match_layer(graph, values)?;
    if value.layer.relu || graph.source(value.input) != rows {
        return Err(graph.unsupported(values, SAME_ROWS));
    }
    Ok((AllAttention { heads, query, key, value: value.layer, output }, rows))
}

/// `scale · (q · k)`: the queries with the scale folded in, the keys, and the rows of both.
fn match_all_scores(
    graph: &Graph,
    weights: OutletId,
    logits: OutletId,
) -> Result<(Layer, Layer, OutletId), CompileError> {
    const HINT: &str = "scores are the product of every row's query and of keys of the same rows";
    let (product, scale) = match_scale(graph, logits);
    let unsupported = || graph.unsupported(product, HINT);
    let operands = match_product_of_two(graph, product).ok_or_else(unsupported)?;
    let keys = key_operand(graph, weights).ok_or_else(unsupported)?;
    let [(a, scale_a), (b, scale_b)] = operands.map(|operand| match_scale(graph, operand));
    let [a, b] = [match_layer(graph, a)?, match_layer(graph, b)?];
    let (mut query, key) = if keys == 1 { (a, b) } else { (b, a) };
    let rows = graph.source(query.input);
    if graph.source(key.input) != rows || query.layer.relu || key.layer.relu {
        return Err(unsupported());
    }
    let scale = scale * scale_a * scale_b;
    let Layer { matrix, bias, .. } = &mut query.layer;
    matrix.values.iter_mut().chain(bias).for_each(|value| *value *= scale);
    Ok((query.layer, key.layer, rows))
}

/// Which operand of the scores' product has the keys: the softmax behind it runs over that operand's rows.
fn key_operand(graph: &Graph, weights: OutletId) -> Option<usize> {
    let softmax = graph.model.node(graph.source(*graph.node(weights).inputs.get(1)?).node);
    let &[mut axis] = softmax.op_as::<Softmax>()?.axes.as_slice() else { return None };
    let mut outlet = *softmax.inputs.first()?;
    loop {
        let node = graph.model.nodes.get(outlet.node)?;
        if let Some(einsum) = node.op_as::<EinSum>() {
            let is_axis = |outputs: &[usize]| outputs.contains(&axis);
            let mut axes = einsum.axes.iter_all_axes();
            let found = axes.find(|found| found.outputs.first().is_some_and(|o| is_axis(o)))?;
            let mut having =
                (0..2).filter(|slot| found.inputs.get(*slot).is_some_and(|i| !i.is_empty()));
            return having.next().filter(|_| having.next().is_none());
        }
        outlet = match node.op_as::<AxisOp>() {
            Some(moved) => {
                axis = moved.recip().transform_axis(axis)?;
                *node.inputs.first()?
            }
            None if node.op_is::<Iff>() => *node.inputs.get(1)?,
            None => graph.with_constant(outlet, "Mul").map(|[value, _]| value)?,
        };
    }
}
