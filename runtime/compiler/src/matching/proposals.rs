//! The three networks of an allocator that proposes (dissertation section 7.4).

use sortie_plans::{CompileError, Layer, Matrix};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::TypedConcat;
use tract_onnx::tract_core::ops::logic::Iff;
use tract_onnx::tract_core::ops::nn::{Reduce, Reducer};

use super::agent::{match_mixed, no_output, uncast};
use super::entities::{AllAttention, SAME_ROWS, match_all_attention};
use super::gru::{
    bias_values, is, match_layer, match_product, match_product_of_two, match_scale, terms,
};
use crate::graph::{Graph, ProposalPart, ProposalRoles};

/// Logits of closed subtasks must be at least this small.
const BLOCKED: f32 = -1.0e9;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ProposalLayers {
    pub(crate) trunk: TrunkLayers,
    pub(crate) step: StepLayers,
    pub(crate) critic: CriticLayers,
}

/// What embeds entities and subtasks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TrunkLayers {
    /// Features to embeddings.
    pub(crate) embed: Layer,
    /// What belonging to a subtask adds `[T, E]`.
    pub(crate) tasks: Matrix,
    /// Attention among the rows of one subtask.
    pub(crate) attention: AllAttention,
}

/// Where an agent's pointer goes, and what its choice changes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StepLayers {
    /// What one more other entity, one more agent, and neither add to a subtask's embedding `[3, E]`.
    pub(crate) counts: Matrix,
    /// The factor of all logits.
    pub(crate) scale: f32,
    /// The update's part of the subtask's embedding.
    pub(crate) from_task: Layer,
    /// The update's part of the agent's embedding.
    pub(crate) from_agent: Layer,
}

/// What values an allocation.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CriticLayers {
    /// Features to embeddings.
    pub(crate) embed: Layer,
    /// What belonging to a subtask adds `[T, E]`.
    pub(crate) tasks: Matrix,
    /// What one more agent, one more other entity, and neither add to the rows of a subtask `[3, E]`.
    pub(crate) counts: Matrix,
    /// Attention among all rows.
    pub(crate) attention: AllAttention,
    /// The mean over agents to the value.
    pub(crate) head: Layer,
}

/// Matches trunk, step and critic, each from its outputs backwards.
pub(crate) fn match_proposals(
    [trunk, step, critic]: [&Graph; 3],
) -> Result<ProposalLayers, CompileError> {
    let matcher = |graph, part| {
        let roles = Graph::proposal_roles(graph)?;
        let wrong = CompileError::OtherNetwork { want: ProposalPart::name(part).into() };
        if roles.part == part { Ok(Matcher { graph, roles }) } else { Err(wrong) }
    };
    Ok(ProposalLayers {
        trunk: matcher(trunk, ProposalPart::Trunk)?.trunk()?,
        step: matcher(step, ProposalPart::Step)?.step()?,
        critic: matcher(critic, ProposalPart::Critic)?.critic()?,
    })
}

struct Matcher<'g> {
    graph: &'g Graph,
    roles: ProposalRoles,
}

/// The terms of a sum.
#[derive(Default)]
struct Sum {
    /// Products with constant matrices, and what is multiplied.
    products: Vec<(Matrix, OutletId)>,
    bias: Option<Vec<f32>>,
    rest: Vec<OutletId>,
}

impl Sum {
    /// Takes the product of what fits.
    fn take(&mut self, fits: impl Fn(OutletId) -> bool) -> Option<Matrix> {
        let place = self.products.iter().position(|(_, input)| fits(*input))?;
        Some(self.products.remove(place).0)
    }

    fn take_rest(&mut self, fits: impl Fn(OutletId) -> bool) -> Option<OutletId> {
        let place = self.rest.iter().position(|outlet| fits(*outlet))?;
        Some(self.rest.remove(place))
    }

    fn is_empty(&self) -> bool {
        self.products.is_empty() && self.rest.is_empty()
    }

    fn bias(&self, outputs: usize) -> Vec<f32> {
        self.bias.clone().unwrap_or_else(|| vec![0.0; outputs])
    }

    /// A layer of this sum's bias.
    fn layer(&self, matrix: Matrix) -> Layer {
        Layer { bias: self.bias(matrix.outputs), matrix, relu: false }
    }
}

impl Matcher<'_> {
    fn trunk(&self) -> Result<TrunkLayers, CompileError> {
        const PLACED: &str = "subtasks sum up rows by entity_task times Cast(Not(is_agent))";
        const ANSWERS: &str =
            "rows of subtasks are Where(And(present, Not(is_agent)), attended, 0)";
        const VISIBLE: &str =
            "attention sees placed · placedᵀ > 0, of those present that are no agents";
        let graph = self.graph;
        let &[embedding, tasks, count] = graph.model.outputs.as_slice() else {
            return Err(no_output());
        };
        let (embed, of_tasks) = self.embedding(embedding)?;
        let fits = |[a, b]: [OutletId; 2]| {
            if self.is_placed(a) { Some(b) } else { self.is_placed(b).then_some(a) }
        };
        let shown = match_product_of_two(graph, tasks).and_then(fits);
        let shown = shown.ok_or_else(|| graph.unsupported(tasks, PLACED))?;
        if !self.graph.sum_of_rows(count).is_some_and(|rows| self.is_placed(rows)) {
            return Err(graph.unsupported(count, PLACED));
        }
        let attended = self.graph.shown(shown, |mask| self.is_answering(mask));
        let attended = attended.ok_or_else(|| graph.unsupported(shown, ANSWERS))?;
        let sees_peers = |visible: OutletId| {
            graph.operands(visible, "And").is_some_and(|[a, b]| {
                self.is_together(a) && self.is_answering(b)
                    || self.is_together(b) && self.is_answering(a)
            })
        };
        let (attention, rows) = self.attention(attended, |visible| {
            if sees_peers(visible) { Ok(()) } else { Err(graph.unsupported(visible, VISIBLE)) }
        })?;
        self.relu_of(rows, embedding)?;
        Ok(TrunkLayers { embed, tasks: of_tasks, attention })
    }

    fn step(&self) -> Result<StepLayers, CompileError> {
        const UPDATE: &str =
            "a subtask becomes itself plus layers on its ReLU and on that of the agent";
        const POINTER: &str =
            "logits are the scaled product of the agent and of subtasks with counts";
        let graph = self.graph;
        let ProposalRoles { agent, entities: task, present: open, .. } = self.roles;
        let &[log_pi, changed] = graph.model.outputs.as_slice() else { return Err(no_output()) };
        let mut sum = self.sum(changed)?;
        let unsupported = || graph.unsupported(changed, UPDATE);
        sum.take_rest(|outlet| self.is(outlet, task)).ok_or_else(unsupported)?;
        let from_task = sum.take(|input| self.is_relu_of(input, task)).ok_or_else(unsupported)?;
        let from_agent = sum.take(|input| self.is_relu_of(input, agent)).ok_or_else(unsupported)?;
        if !sum.is_empty() {
            return Err(unsupported());
        }
        let bias = vec![0.0; from_task.outputs];
        let from_task = Layer { matrix: from_task, bias, relu: false };
        let from_agent = sum.layer(from_agent);

        let (pointed, scale) = match_scale(graph, self.logits(log_pi, open)?);
        let unsupported = || graph.unsupported(pointed, POINTER);
        let [a, b] = match_product_of_two(graph, pointed).ok_or_else(unsupported)?;
        let sized = if self.is(a, agent) { b } else { a };
        if !(self.is(a, agent) || self.is(b, agent)) {
            return Err(unsupported());
        }
        let mut sum = self.sum(sized)?;
        sum.take_rest(|outlet| self.is(outlet, task)).ok_or_else(unsupported)?;
        let counts = self.counts(
            sum,
            [&|outlet| self.is(outlet, self.roles.groups), &|outlet| {
                self.is(outlet, self.roles.counts)
            }],
        );
        Ok(StepLayers { counts: counts.ok_or_else(unsupported)?, scale, from_task, from_agent })
    }

    fn critic(&self) -> Result<CriticLayers, CompileError> {
        const ROWS: &str =
            "rows are a ReLU of layers on entities, on their subtasks and on its counts";
        const MEAN: &str =
            "the value is a layer on the mean over agents of the attended rows' ReLU";
        let graph = self.graph;
        let &[value] = graph.model.outputs.as_slice() else { return Err(no_output()) };
        let found = match_layer(graph, value)?;
        let mean = || graph.unsupported(found.input, MEAN);
        if found.layer.relu {
            return Err(mean());
        }
        let shown = self.mean_of(found.input).ok_or_else(mean)?;
        let attended = self.graph.shown(shown, |mask| {
            let present_agents = graph.operands(mask, "And");
            present_agents.is_some_and(|both| self.are(both, self.roles.present, self.roles.agent))
        });
        let attended = attended.ok_or_else(mean)?;
        let low = graph.with_constant(attended, "Max");
        let relu = low.filter(|[_, low]| graph.uniform(*low) == Some(0.0)).ok_or_else(mean)?;
        let (attention, rows) = self.attention(relu[0], |visible| {
            let fits = self.is(visible, self.roles.present);
            let hint = "attention sees everybody present";
            if fits { Ok(()) } else { Err(graph.unsupported(visible, hint)) }
        })?;
        let unsupported = || graph.unsupported(rows, ROWS);
        let low = graph.with_constant(rows, "Max");
        let sum =
            low.filter(|[_, low]| graph.uniform(*low) == Some(0.0)).ok_or_else(unsupported)?;
        let mut sum = self.sum(sum[0])?;
        let embed =
            sum.take(|input| self.is(input, self.roles.entities)).ok_or_else(unsupported)?;
        let tasks = sum.take(|input| self.is_counted(input)).ok_or_else(unsupported)?;
        let by_task = |outlet: OutletId| {
            let [a, b] = match_product_of_two(graph, outlet)?;
            if self.is_counted(a) { Some(b) } else { self.is_counted(b).then_some(a) }
        };
        let counted = sum.take_rest(|outlet| by_task(outlet).is_some()).and_then(by_task);
        let (counted, scale) = match_scale(graph, counted.ok_or_else(unsupported)?);
        if !sum.is_empty() {
            return Err(unsupported());
        }
        let of_kind = |agents: bool| {
            move |outlet: OutletId| {
                self.graph
                    .sum_of_rows(outlet)
                    .is_some_and(|rows| self.is_counted_kind(rows, agents))
            }
        };
        let counts = self.counts(self.sum(counted)?, [&of_kind(true), &of_kind(false)]);
        let mut counts = counts.ok_or_else(unsupported)?;
        counts.values.iter_mut().for_each(|value| *value *= scale);
        let embed = sum.layer(embed);
        Ok(CriticLayers { embed, tasks, counts, attention, head: found.layer })
    }

    /// A layer on the entities, and what their subtasks add.
    fn embedding(&self, outlet: OutletId) -> Result<(Layer, Matrix), CompileError> {
        const HINT: &str = "an embedding is a layer on entities plus a product with entity_task";
        let mut sum = self.sum(outlet)?;
        let unsupported = || self.graph.unsupported(outlet, HINT);
        let embed =
            sum.take(|input| self.is(input, self.roles.entities)).ok_or_else(unsupported)?;
        let tasks = sum.take(|input| self.is(input, self.roles.groups)).ok_or_else(unsupported)?;
        if sum.is_empty() { Ok((sum.layer(embed), tasks)) } else { Err(unsupported()) }
    }

    /// `log_pi` back to the logits: `Where(open, x - max - ln Σ exp (x - max), _)` of `x = Where(open, logits, -1e30)`.
    fn logits(&self, log_pi: OutletId, open: usize) -> Result<OutletId, CompileError> {
        const HINT: &str =
            "log_pi is the logarithm of the softmax of Where(task_open, logits, -1e30)";
        let graph = self.graph;
        let masked = |outlet: OutletId| {
            let node = graph.node(outlet);
            let &[mask, value, other] = node.inputs.as_slice() else { return None };
            let fits = node.op_is::<Iff>() && self.is(mask, open);
            fits.then_some((value, graph.uniform(other)?))
        };
        let reduced = |outlet: OutletId, reducer: Reducer| {
            let reduce = graph.node(outlet).op_as::<Reduce>()?;
            (reduce.reducer == reducer).then(|| graph.node(outlet).inputs.first().copied())?
        };
        let only = |outlet: OutletId| graph.node(outlet).inputs.first().copied();
        let same = |a: OutletId, b: OutletId| graph.source(a) == graph.source(b);
        let found = || {
            let (normalised, never) = masked(log_pi)?;
            let [shifted, log] = graph.operands(normalised, "Sub")?;
            let total = is(graph, log, "Ln").then(|| only(log))??;
            let powers = reduced(total, Reducer::Sum)?;
            let exponent = is(graph, powers, "Exp").then(|| only(powers))??;
            let [open_logits, largest] = graph.operands(shifted, "Sub")?;
            let of_largest = reduced(largest, Reducer::Max)?;
            let (logits, blocked) = masked(open_logits)?;
            let fits = same(exponent, shifted) && same(of_largest, open_logits);
            (fits && blocked <= BLOCKED && never <= BLOCKED).then_some(logits)
        };
        found().ok_or_else(|| graph.unsupported(log_pi, HINT))
    }

    /// Attention of all rows: the layers, and the outlet of the rows.
    fn attention(
        &self,
        attended: OutletId,
        check: impl Fn(OutletId) -> Result<(), CompileError>,
    ) -> Result<(AllAttention, OutletId), CompileError> {
        let graph = self.graph;
        let output = match_layer(graph, attended)?;
        let (weights, values) = match_mixed(graph, output.input)?;
        let mask = graph.node(weights).inputs.first().copied().ok_or_else(no_output)?;
        check(mask)?;
        let present = graph.source(mask);
        let found = match_all_attention(graph, [weights, values], present, output.layer)?;
        if found.0.output.relu { Err(graph.unsupported(values, SAME_ROWS)) } else { Ok(found) }
    }

    /// What two counts and a constant add, as vectors.
    fn counts(&self, mut sum: Sum, kinds: [&dyn Fn(OutletId) -> bool; 2]) -> Option<Matrix> {
        let mut vectors: [Option<Vec<f32>>; 2] = [None, None];
        for (matrix, input) in std::mem::take(&mut sum.products) {
            let (counts, scale) = match_scale(self.graph, input);
            let node = self.graph.node(counts);
            let counts = match node.op_as::<TypedConcat>() {
                Some(_) => node.inputs.to_vec(),
                None => vec![counts],
            };
            if counts.len() != matrix.inputs {
                return None;
            }
            for (count, vector) in counts.into_iter().zip(matrix.values.chunks(matrix.outputs)) {
                let place = kinds.iter().position(|fits| fits(count))?;
                let to = vectors.get_mut(place).filter(|vector| vector.is_none())?;
                *to = Some(vector.iter().map(|value| value * scale).collect());
            }
        }
        let [first, second] = vectors;
        let (first, second) = (first?, second?);
        let outputs = first.len();
        let values = [first, second, sum.bias(outputs)].concat();
        (sum.is_empty() && values.len() == 3 * outputs).then_some(Matrix {
            inputs: 3,
            outputs,
            values,
        })
    }

    /// The terms of a sum, constants added up.
    fn sum(&self, outlet: OutletId) -> Result<Sum, CompileError> {
        let mut sum = Sum::default();
        for term in terms(self.graph, outlet) {
            if let Some(constant) = self.graph.constant(self.graph.source(term)) {
                let bias = bias_values(self.graph, self.graph.source(term), constant.len());
                if sum.bias.is_some() || bias.is_none() {
                    return Err(self.graph.unsupported(outlet, "a sum has one bias"));
                }
                sum.bias = bias;
            } else if let Ok((matrix, input)) = match_product(self.graph, term) {
                sum.products.push((matrix, input));
            } else {
                sum.rest.push(term);
            }
        }
        Ok(sum)
    }

    fn relu_of(&self, rows: OutletId, of: OutletId) -> Result<(), CompileError> {
        let low = self.graph.with_constant(rows, "Max");
        let fits = low.is_some_and(|[value, low]| {
            self.graph.source(value) == self.graph.source(of)
                && self.graph.uniform(low) == Some(0.0)
        });
        let hint = "attention reads the ReLU of the embedding";
        if fits { Ok(()) } else { Err(self.graph.unsupported(rows, hint)) }
    }

    fn is_relu_of(&self, outlet: OutletId, input: usize) -> bool {
        let low = self.graph.with_constant(outlet, "Max");
        low.is_some_and(|[value, low]| {
            self.is(value, input) && self.graph.uniform(low) == Some(0.0)
        })
    }

    /// `Sum(rows) · 1 / Max(Sum(Cast(is_agent)), 1)`: the rows.
    fn mean_of(&self, outlet: OutletId) -> Option<OutletId> {
        let [a, b] = self.graph.operands(outlet, "Mul")?;
        let (reciprocal, sum) = if is(self.graph, a, "Recip") { (a, b) } else { (b, a) };
        let divisor = *self.graph.node(reciprocal).inputs.first()?;
        let [count, least] = self.graph.with_constant(divisor, "Max")?;
        let agents = uncast(self.graph, self.graph.source(self.graph.sum_of_rows(count)?));
        let fits = is(self.graph, reciprocal, "Recip")
            && self.graph.uniform(least) == Some(1.0)
            && self.is(agents, self.roles.agent);
        fits.then(|| self.graph.sum_of_rows(sum))?
    }

    /// `entity_task · Cast(Not(is_agent))`.
    fn is_placed(&self, outlet: OutletId) -> bool {
        let both = self.graph.operands(outlet, "Mul");
        both.is_some_and(|[a, b]| {
            let fits = |a, b| self.is(a, self.roles.groups) && self.is_number_of_others(b);
            fits(a, b) || fits(b, a)
        })
    }

    /// `placed · placedᵀ > 0`.
    fn is_together(&self, outlet: OutletId) -> bool {
        let node = self.graph.node(outlet);
        let &[shared, low] = node.inputs.as_slice() else { return false };
        let both = match_product_of_two(self.graph, shared);
        node.op.name() == "GT"
            && self.graph.uniform(low) == Some(0.0)
            && both.is_some_and(|[a, b]| self.is_placed(a) && self.is_placed(b))
    }

    /// `And(present, Not(is_agent))`.
    fn is_answering(&self, outlet: OutletId) -> bool {
        let both = self.graph.operands(outlet, "And");
        both.is_some_and(|[a, b]| {
            self.is(a, self.roles.present) && self.is_others(b)
                || self.is(b, self.roles.present) && self.is_others(a)
        })
    }

    /// `Where(Or(present, Not(is_agent)), entity_task, 0)`: absent agents have no subtask.
    fn is_counted(&self, outlet: OutletId) -> bool {
        let belongs = |mask: OutletId| {
            self.graph.operands(mask, "Or").is_some_and(|[a, b]| {
                self.is(a, self.roles.present) && self.is_others(b)
                    || self.is(b, self.roles.present) && self.is_others(a)
            })
        };
        self.graph.shown(outlet, belongs).is_some_and(|rows| self.is(rows, self.roles.groups))
    }

    /// The counted rows of agents, or of others.
    fn is_counted_kind(&self, outlet: OutletId, agents: bool) -> bool {
        let both = self.graph.operands(outlet, "Mul");
        both.is_some_and(|[a, b]| {
            let is_kind = |outlet| match agents {
                true => self.is(uncast(self.graph, self.graph.source(outlet)), self.roles.agent),
                false => self.is_number_of_others(outlet),
            };
            self.is_counted(a) && is_kind(b) || self.is_counted(b) && is_kind(a)
        })
    }

    fn is_number_of_others(&self, outlet: OutletId) -> bool {
        self.is_others(uncast(self.graph, self.graph.source(outlet)))
    }

    /// `Not(is_agent)`.
    fn is_others(&self, outlet: OutletId) -> bool {
        let node = self.graph.node(outlet);
        let input = node.inputs.first().copied();
        is(self.graph, outlet, "Not") && input.is_some_and(|input| self.is(input, self.roles.agent))
    }

    fn are(&self, [a, b]: [OutletId; 2], first: usize, second: usize) -> bool {
        self.is(a, first) && self.is(b, second) || self.is(b, first) && self.is(a, second)
    }

    /// Whether an outlet only reshapes this input.
    fn is(&self, outlet: OutletId, input: usize) -> bool {
        self.graph.input(input) == Some(self.graph.source(outlet))
    }
}
