//! `allocator_trunk.onnx`, `allocator_step.onnx` and `allocator_critic.onnx`: a policy that proposes allocations, and the
//! critic that chooses among them (dissertation section 7.4).
//!
//! The policy draws one agent's subtask after the other, so it is two graphs: the trunk runs once, the step once for
//! every agent, with the embedding of the subtask that was chosen taken over in between. Counts are raw, the graphs
//! scale them; the order of the subtasks is the identity.

use sortie_learn::export::attention::{
    BLOCKED, ExportError, Layer, Layout, Matrix, axis, by_heads, inputs_first, layer, mixed,
};
use sortie_learn::export::onnx::{Attribute, Dim, Element, Graph, metadata};
use sortie_nn::tape::Parameters;

use super::allocation::{AllocationCritic, AllocationPolicy, AllocationShape, COUNT_SCALE};

/// The three graphs of an allocator that proposes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProposalGraphs {
    /// `entities [N, d], entity_task [N, T], present [N], is_agent [N] -> embedding [N, E], task_embedding [T, E],
    /// task_count [T]`
    pub trunk: Vec<u8>,
    /// `agent_embedding [E], task_embedding [T, E], task_count [T], agent_count [T], task_open [T] -> log_pi [T],
    /// task_embedding_if_chosen [T, E]`
    pub step: Vec<u8>,
    /// `entities [N, d], entity_task [N, T], present [N], is_agent [N] -> value [1]`
    pub critic: Vec<u8>,
}

/// Writes the policy and the critic as ONNX. `contract` is the hash of the contract that they were trained for.
///
/// # Errors
/// The heads do not divide the width, or a number is not finite.
pub fn export_proposals(
    policy: &AllocationPolicy,
    critic: &AllocationCritic,
    contract: u64,
) -> Result<ProposalGraphs, ExportError> {
    for AllocationShape { width, heads, .. } in [policy.shape, critic.shape] {
        if heads == 0 || !width.is_multiple_of(heads) {
            return Err(ExportError::Heads { heads, width });
        }
    }
    Ok(ProposalGraphs {
        trunk: trunk(policy, contract)?,
        step: step(policy, contract)?,
        critic: critic_graph(critic, contract)?,
    })
}

fn trunk(policy: &AllocationPolicy, contract: u64) -> Result<Vec<u8>, ExportError> {
    let AllocationShape { columns, width, .. } = policy.shape;
    let (n, e, t) = (Dim::Symbol("N"), Dim::Fixed(width), Dim::Fixed(columns));
    let mut writer = Writer::new(policy.shape, &policy.parameters);
    writer.add_entities("agents: their last subtask");
    let graph = &mut writer.graph;
    graph.output("embedding", Element::Float, &[n, e], "Every entity, before any ReLU.");
    graph.output("task_embedding", Element::Float, &[t, e], "Every subtask, nobody in it.");
    let doc = "Entities of every subtask that are no agents.";
    graph.output("task_count", Element::Float, &[t], doc);

    let (features, task) = writer.embed("entity_task")?;
    let embedding = writer.graph.node("embedding", "Add", &[&features, &task], &[]);
    let active = writer.graph.node("active", "Relu", &[&embedding], &[]);
    // What is no agent is placed in its subtasks; who is present answers there.
    writer.graph.node("others", "Not", &["is_agent"], &[]);
    let other = writer.number("others");
    let column = writer.column("others", &other);
    let placed = writer.graph.node("placed", "Mul", &["entity_task", &column], &[]);
    let answers = writer.graph.node("answers", "And", &["present", "others"], &[]);
    let order = [Attribute::Ints("perm", &[1, 0])];
    let by_task = writer.graph.node("placed.by_task", "Transpose", &[&placed], &order);
    let shared = writer.graph.node("shared", "MatMul", &[&placed, &by_task], &[]);
    let zero = writer.graph.floats("zero", &[], &[0.0]).to_owned();
    let together = writer.graph.node("together", "Greater", &[&shared, &zero], &[]);
    let visible = writer.graph.node("visible", "And", &[&together, &answers], &[]);
    let attended = writer.attention(&active, &visible)?;
    let answering = writer.column("answers", "answers");
    let shown = writer.graph.node("shown", "Where", &[&answering, &attended, &zero], &[]);
    writer.graph.node("task_embedding", "MatMul", &[&by_task, &shown], &[]);
    writer.sum("task_count", &placed, 0, false);
    let doc = "Embeds entities and subtasks once for all proposals.";
    Ok(writer.finish("allocator_trunk", "proposals-trunk", doc, contract))
}

fn step(policy: &AllocationPolicy, contract: u64) -> Result<Vec<u8>, ExportError> {
    let AllocationShape { columns, width, .. } = policy.shape;
    let (e, t) = (Dim::Fixed(width), Dim::Fixed(columns));
    let mut writer = Writer::new(policy.shape, &policy.parameters);
    let graph = &mut writer.graph;
    let doc = "The row of `embedding` of the agent that chooses.";
    graph.input("agent_embedding", Element::Float, &[e], doc);
    graph.input("task_embedding", Element::Float, &[t, e], "Every subtask as it is by now.");
    graph.input("task_count", Element::Float, &[t], "Its entities that are no agents.");
    graph.input("agent_count", Element::Float, &[t], "Its agents so far.");
    graph.input("task_open", Element::Bool, &[t], "True where it may be chosen.");
    let doc = "Logarithms of the probabilities; minus infinity of closed subtasks.";
    graph.output("log_pi", Element::Float, &[t], doc);
    let doc = "What each subtask becomes by the agent choosing it.";
    graph.output("task_embedding_if_chosen", Element::Float, &[t, e], doc);

    let counts = writer.counts(["task_count", "agent_count"], COUNT_SCALE);
    let counted = writer.layer("count", &counts, "count", Layout::InputsFirst, 2)?;
    let sizes = writer.graph.node("sized", "Add", &["task_embedding", &counted], &[]);
    let agent = writer.column("agent", "agent_embedding");
    let pointed = writer.graph.node("pointed", "MatMul", &[&sizes, &agent], &[]);
    let flat = writer.graph.integers("flat", &[columns as i64]).to_owned();
    let pointed = writer.graph.node("pointed.flat", "Reshape", &[&pointed, &flat], &[]);
    let scale = [1.0 / (width as f32).sqrt()];
    let scale = writer.graph.floats("scale", &[], &scale).to_owned();
    let logits = writer.graph.node("logits", "Mul", &[&pointed, &scale], &[]);
    writer.log_softmax(&logits);

    let active = writer.graph.node("task.active", "Relu", &["task_embedding"], &[]);
    let task = writer.tensor("update.task.weight");
    let from_task = writer.product("from_task", &active, task, Layout::OutputsFirst, width)?;
    let active = writer.graph.node("agent.active", "Relu", &["agent_embedding"], &[]);
    let row = writer.graph.integers("row", &[1, width as i64]).to_owned();
    let active = writer.graph.node("agent.row", "Reshape", &[&active, &row], &[]);
    let layout = Layout::OutputsFirst;
    let from_agent = writer.layer("from_agent", &active, "update.agent", layout, width)?;
    let change = writer.graph.node("change", "Add", &[&from_task, &from_agent], &[]);
    let name = "task_embedding_if_chosen";
    writer.graph.node(name, "Add", &["task_embedding", &change], &[]);
    let doc = "One agent's choice, and what it changes.";
    Ok(writer.finish("allocator_step", "proposals-step", doc, contract))
}

fn critic_graph(critic: &AllocationCritic, contract: u64) -> Result<Vec<u8>, ExportError> {
    let mut writer = Writer::new(critic.shape, &critic.parameters);
    writer.add_entities("agents: the proposal");
    let doc = "What the allocation is worth.";
    writer.graph.output("value", Element::Float, &[Dim::Fixed(1)], doc);
    let zero = writer.graph.floats("zero", &[], &[0.0]).to_owned();
    writer.graph.node("others", "Not", &["is_agent"], &[]);
    let counts_in = writer.graph.node("belongs", "Or", &["present", "others"], &[]);
    let column = writer.column("belongs", &counts_in);
    let placed = writer.graph.node("placed", "Where", &[&column, "entity_task", &zero], &[]);
    let mut of_kind = |kind: &str, mask: &str| {
        let number = writer.number(mask);
        let column = writer.column(kind, &number);
        let rows = writer.graph.node(kind, "Mul", &[&placed, &column], &[]);
        writer.sum(&format!("{kind}.count"), &rows, 0, false)
    };
    let agents = of_kind("placed_agents", "is_agent");
    let others = of_kind("placed_others", "others");
    let counts = writer.counts([&agents, &others], 1.0);
    let counted = writer.layer("count", &counts, "count", Layout::InputsFirst, 2)?;
    let scale = writer.graph.floats("count.scale", &[], &[COUNT_SCALE]).to_owned();
    let counted = writer.graph.node("counted", "Mul", &[&counted, &scale], &[]);

    let (features, task) = writer.embed(&placed)?;
    let count = writer.graph.node("counted.rows", "MatMul", &[&placed, &counted], &[]);
    let sum = writer.graph.node("features.task", "Add", &[&features, &task], &[]);
    let sum = writer.graph.node("rows", "Add", &[&sum, &count], &[]);
    let active = writer.graph.node("active", "Relu", &[&sum], &[]);
    let attended = writer.attention(&active, "present")?;
    let attended = writer.graph.node("attended.relu", "Relu", &[&attended], &[]);
    let answers = writer.graph.node("answers", "And", &["present", "is_agent"], &[]);
    let answering = writer.column("answers", &answers);
    let shown = writer.graph.node("shown", "Where", &[&answering, &attended, &zero], &[]);
    let sum = writer.sum("mean.sum", &shown, 0, true);
    let number = writer.number("is_agent.all");
    let count = writer.sum("mean.count", &number, 0, true);
    let one = writer.graph.floats("mean.one", &[], &[1.0]).to_owned();
    let count = writer.graph.node("mean.divisor", "Max", &[&count, &one], &[]);
    let mean = writer.graph.node("mean", "Div", &[&sum, &count], &[]);
    let value = writer.add_head(critic, &mean)?;
    let flat = writer.graph.integers("value.shape", &[1]).to_owned();
    writer.graph.node("value", "Reshape", &[&value, &flat], &[]);
    let doc = "The value of a whole allocation, in the units of returns.";
    Ok(writer.finish("allocator_critic", "proposals-critic", doc, contract))
}

/// A graph that is written.
struct Writer<'a> {
    graph: Graph,
    shape: AllocationShape,
    parameters: &'a Parameters,
}

impl<'a> Writer<'a> {
    fn new(shape: AllocationShape, parameters: &'a Parameters) -> Self {
        Self { graph: Graph::default(), shape, parameters }
    }

    /// Declares all entities.
    fn add_entities(&mut self, agents: &str) {
        let (n, t) = (Dim::Symbol("N"), Dim::Fixed(self.shape.columns));
        let rows = [n, Dim::Fixed(self.shape.features)];
        let graph = &mut self.graph;
        graph.input("entities", Element::Float, &rows, "Features of every entity.");
        let doc = format!("1 where the entity belongs to the subtask; {agents}.");
        graph.input("entity_task", Element::Float, &[n, t], &doc);
        graph.input("present", Element::Bool, &[n], "True where the entity exists.");
        graph.input("is_agent", Element::Bool, &[n], "True for agents, present or not.");
    }

    /// A tensor of the network by its name.
    fn tensor(&self, name: &str) -> &'a [f32] {
        let tensor = self.parameters.tensors().iter().find(|tensor| tensor.name == name);
        tensor.map_or(&[], |tensor| &self.parameters.values[tensor.range.clone()])
    }

    /// What the embedding makes of features, and of these subtasks.
    fn embed(&mut self, tasks: &str) -> Result<(String, String), ExportError> {
        let AllocationShape { features, columns, .. } = self.shape;
        let layout = Layout::InputsFirst;
        let of_features = self.layer("fc1", "entities", "entity", layout, features)?;
        let of_task = self.tensor("task.weight");
        Ok((of_features, self.product("task", tasks, of_task, layout, columns)?))
    }

    /// `input W` of a matrix with so many inputs and as many outputs as the networks are wide.
    fn product(
        &mut self,
        name: &str,
        input: &str,
        values: &[f32],
        layout: Layout,
        inputs: usize,
    ) -> Result<String, ExportError> {
        let sizes = [inputs, self.shape.width];
        let values = inputs_first(name, &Matrix { values, layout }, sizes)?;
        let weight = format!("{name}.weight");
        self.graph.floats(&weight, &sizes, &values);
        Ok(self.graph.node(&format!("{name}.product"), "MatMul", &[input, &weight], &[]))
    }

    /// `input W + b` of such a layer, by its name in the network.
    fn layer(
        &mut self,
        name: &str,
        input: &str,
        of: &str,
        layout: Layout,
        inputs: usize,
    ) -> Result<String, ExportError> {
        let [values, bias] = ["weight", "bias"].map(|part| self.tensor(&format!("{of}.{part}")));
        let own = Layer { weight: Matrix { values, layout }, bias };
        layer(&mut self.graph, name, input, &own, [inputs, self.shape.width])
    }

    /// The last layer with what the normalisation of targets makes of its value.
    fn add_head(&mut self, critic: &AllocationCritic, input: &str) -> Result<String, ExportError> {
        let ([popart_weight, popart_bias], popart) = (critic.head(), critic.popart);
        let (mean, deviation) = (popart.mean as f32, popart.variance.sqrt() as f32);
        let factor = popart_weight * deviation;
        let scaled = |name: &str| self.tensor(name).iter().map(|number| number * factor);
        let weight: Vec<f32> = scaled("value.weight").collect();
        let shift = popart_bias * deviation;
        let bias: Vec<f32> = scaled("value.bias").map(|bias| bias + shift + mean).collect();
        let weight = Matrix { values: &weight, layout: Layout::OutputsFirst };
        let own = Layer { weight, bias: &bias };
        layer(&mut self.graph, "head", input, &own, [self.shape.width, 1])
    }

    /// A mask as numbers.
    fn number(&mut self, mask: &str) -> String {
        let to_float = [Attribute::Int("to", Element::Float.id())];
        let of = mask.trim_end_matches(".all");
        self.graph.node(&format!("{mask}.number"), "Cast", &[of], &to_float)
    }

    /// A vector as a column.
    fn column(&mut self, name: &str, vector: &str) -> String {
        let place = format!("{name}.axis");
        self.graph.integers(&place, &[1]);
        self.graph.node(&format!("{name}.column"), "Unsqueeze", &[vector, &place], &[])
    }

    fn sum(&mut self, name: &str, rows: &str, along: i64, keep: bool) -> String {
        let place = format!("{name}.along");
        self.graph.integers(&place, &[along]);
        let keep = [Attribute::Int("keepdims", keep.into())];
        self.graph.node(name, "ReduceSum", &[rows, &place], &keep)
    }

    /// Two counts of every subtask side by side, each times `scale`.
    fn counts(&mut self, [first, second]: [&str; 2], scale: f32) -> String {
        let (first, second) =
            (self.column("counts.first", first), self.column("counts.second", second));
        let counts = self.graph.node("counts", "Concat", &[&first, &second], &[axis(1)]);
        if scale == 1.0 {
            return counts;
        }
        self.graph.floats("counts.scale", &[], &[scale]);
        self.graph.node("counts.scaled", "Mul", &[&counts, "counts.scale"], &[])
    }

    /// `log_pi` of the open subtasks.
    fn log_softmax(&mut self, logits: &str) {
        let graph = &mut self.graph;
        graph.floats("blocked", &[], &[BLOCKED]);
        graph.floats("never", &[], &[f32::NEG_INFINITY]);
        graph.integers("all", &[0]);
        let keep = [Attribute::Int("keepdims", 1)];
        graph.node("open_logits", "Where", &["task_open", logits, "blocked"], &[]);
        let largest = [Attribute::Ints("axes", &[0]), Attribute::Int("keepdims", 1)];
        graph.node("largest", "ReduceMax", &["open_logits"], &largest);
        graph.node("shifted", "Sub", &["open_logits", "largest"], &[]);
        graph.node("powers", "Exp", &["shifted"], &[]);
        graph.node("total", "ReduceSum", &["powers", "all"], &keep);
        graph.node("log_total", "Log", &["total"], &[]);
        graph.node("normalised", "Sub", &["shifted", "log_total"], &[]);
        graph.node("log_pi", "Where", &["task_open", "normalised", "never"], &[]);
    }

    /// Attention of every row to those that `visible` shows it.
    fn attention(&mut self, rows: &str, visible: &str) -> Result<String, ExportError> {
        let AllocationShape { width, heads, .. } = self.shape;
        let mut parts = self.tensor("attention.in.weight").chunks(width * width);
        let mut project = |name: &str| {
            let own = parts.next().unwrap_or_default();
            self.product(name, rows, own, Layout::OutputsFirst, width)
        };
        let (query, key) = (project("attention.query")?, project("attention.key")?);
        let value = project("attention.value")?;
        let graph = &mut self.graph;
        graph.integers("attention.split", &[0, heads as i64, (width / heads) as i64]);
        let query = by_heads(graph, &query, &[1, 0, 2]);
        let key = by_heads(graph, &key, &[1, 2, 0]);
        let value = by_heads(graph, &value, &[1, 0, 2]);
        let mixed = mixed(graph, [&query, &key, &value], visible, [0, width, heads]);
        let (name, layout) = ("attention.out", Layout::OutputsFirst);
        self.layer(name, &mixed, name, layout, width)
    }

    fn finish(self, name: &str, kind: &str, doc: &str, contract: u64) -> Vec<u8> {
        let Self { graph, shape, .. } = self;
        let sizes = [("sortie.features", shape.features), ("sortie.tasks", shape.columns)];
        graph.into_model(name, doc, &metadata(kind, contract, sizes))
    }
}

#[cfg(test)]
mod tests;
