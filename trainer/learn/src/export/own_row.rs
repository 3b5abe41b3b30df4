//! The graphs of agents that decide by their own row: by a network, by options over three of them, or by a table.
//!
//! Of tables, one graph holds those of all agents. What an agent sees becomes two whole numbers, a place and what it
//! holds; its number, and these, are the row.

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::tape::Linear;

use super::attention::{ExportError, check};
use super::onnx::{Attribute, Dim, Element, Graph, metadata};

/// The input with the agent's number.
pub const AGENT_NUMBER: &str = "agent";

/// Networks of dense layers over an agent's own row, leaky ReLU between them.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnRowNetworks {
    /// What leaky ReLU makes of numbers below zero.
    pub slope: f32,
    /// By agents: which network is its.
    pub network_of: Vec<usize>,
    /// The networks.
    pub networks: Vec<OwnRowNetwork>,
}

/// One of them.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnRowNetwork {
    /// Features that it takes, the first of a row.
    pub features: usize,
    /// Its layers. The first may take besides which of the network's agents decides, as zeros and a one; the last scores
    /// the first actions.
    pub layers: Vec<DenseLayer>,
}

/// A dense layer.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseLayer {
    /// Columns.
    pub inputs: usize,
    /// `[outputs, inputs]`
    pub weight: Vec<f32>,
    /// `[outputs]`
    pub bias: Vec<f32>,
}

impl OwnRowNetworks {
    /// The agents that decide by a network.
    pub fn agents(&self, network: usize) -> Vec<usize> {
        let agents = self.network_of.iter().enumerate();
        agents.filter(|(_, of)| **of == network).map(|(agent, _)| agent).collect()
    }

    /// Whether graphs are told which agent decides: all are, where it matters to any.
    pub fn told_number(&self) -> bool {
        let takes =
            |network: &OwnRowNetwork| network.layers.first().map_or(0, |first| first.inputs);
        self.networks.iter().any(|network| takes(network) > network.features)
    }

    /// Writes one as ONNX: `observation f32 [1, d] -> logits f32 [1, U]`, with the input `agent i64 [1]` where graphs
    /// are told who decides.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_onnx(&self, network: usize, contract: u64) -> Result<Vec<u8>, ExportError> {
        let mut graph = Graph::default();
        let one = Dim::Fixed(1);
        let OwnRowNetwork { features, layers } = &self.networks[network];
        let row = "The agent's own row, as far as it sees.";
        graph.input("observation", Element::Float, &[one, Dim::Fixed(*features)], row);
        let scores = "A score for every action, not masked by availability.";
        let actions = self.networks[network].actions();
        graph.output("logits", Element::Float, &[one, Dim::Fixed(actions)], scores);
        let (mut from, mut inputs) = ("observation".to_owned(), *features);
        if self.told_number() {
            graph.input(AGENT_NUMBER, Element::Int64, &[one], "The agent's number, from 0.");
            (from, inputs) = self.add_number(&mut graph, network, [&from, AGENT_NUMBER]);
        }
        for (index, layer) in layers.iter().enumerate() {
            from = layer.add_to(&mut graph, &format!("layer.{index}"), (&from, inputs))?;
            if index + 1 < layers.len() {
                let slope = Attribute::Float("alpha", self.slope);
                from = graph.node(&format!("hidden.{index}"), "LeakyRelu", &[&from], &[slope]);
            }
            inputs = layer.bias.len();
        }
        graph.node("logits", "Identity", &[&from], &[]);
        let doc = "Scores of one agent's actions, by its own row.";
        Ok(graph.into_model("agent", doc, &metadata("policy", contract, [])))
    }

    /// Adds to a row which of the network's agents decides; returns the name and the columns of both.
    fn add_number(
        &self,
        graph: &mut Graph,
        network: usize,
        [row, number]: [&str; 2],
    ) -> (String, usize) {
        let agents: Vec<i64> = self.agents(network).into_iter().map(|agent| agent as i64).collect();
        let columns = agents.len();
        graph.integers("agents", &agents);
        graph.integers("agents.sizes", &[1, columns as i64]);
        graph.node("is_agent", "Equal", &[number, "agents"], &[]);
        let float = Attribute::Int("to", Element::Float.id());
        graph.node("is_agent.numbers", "Cast", &["is_agent"], &[float]);
        graph.node("identity", "Reshape", &["is_agent.numbers", "agents.sizes"], &[]);
        let axis = Attribute::Int("axis", 1);
        let shown = graph.node("shown", "Concat", &[row, "identity"], &[axis]);
        (shown, self.networks[network].features + columns)
    }
}

impl OwnRowNetwork {
    /// Actions that it scores.
    pub fn actions(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.bias.len())
    }
}

impl DenseLayer {
    /// A layer of these parameters, whose weights are stored as PyTorch does.
    pub fn of(layer: Linear, parameters: &[f32]) -> Self {
        let LinearShape { input: inputs, output } = layer.shape;
        let bias =
            layer.bias_range().map_or_else(|| vec![0.0; output], |bias| parameters[bias].to_vec());
        Self { inputs, weight: parameters[layer.weight_range()].to_vec(), bias }
    }

    /// `[inputs, outputs]`
    fn turned(&self) -> Vec<f32> {
        let column = |input| self.weight.iter().skip(input).step_by(self.inputs);
        (0..self.inputs).flat_map(column).copied().collect()
    }

    /// Adds it to a graph, behind a matrix of so many columns; `tensors` is what errors call weight and bias.
    fn add_to(
        &self,
        graph: &mut Graph,
        name: &str,
        (from, columns): (&str, usize),
    ) -> Result<String, ExportError> {
        let named = |what: &str| format!("{name}.{what}");
        let outputs = self.bias.len();
        check(name, &self.weight, self.inputs * outputs)?;
        check(name, &self.bias, outputs)?;
        let mut weight = self.turned();
        // A network that makes no difference between agents has no weights for their numbers.
        weight.resize(columns * outputs, 0.0);
        graph.floats(&named("weight"), &[columns, outputs], &weight);
        graph.floats(&named("bias"), &[outputs], &self.bias);
        let products = graph.node(&named("products"), "MatMul", &[from, &named("weight")], &[]);
        Ok(graph.node(&named("sums"), "Add", &[&products, &named("bias")], &[]))
    }
}

/// The input with the number of the goal.
pub const GOAL: &str = "goal";

/// Networks over columns that are 0 or 1, ReLU between their layers.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionGraphs {
    /// Hidden layers of the controller.
    pub controller: [DenseLayer; 2],
    /// Its head for each goal, an output for each action.
    pub heads: Vec<DenseLayer>,
    /// An output for each milestone: what it is worth to go for it.
    pub meta: [DenseLayer; 3],
    /// An output for each milestone: how likely it can be reached next, as a logit.
    pub affordance: [DenseLayer; 3],
}

impl OptionGraphs {
    /// Writes the controller, `shown f32 [1, C], goal i64 [1] -> values f32 [1, U]`; the meta-controller,
    /// `shown -> values f32 [1, K]`; and the affordances, `shown -> likelihoods f32 [1, K]`.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_onnx(&self, contract: u64) -> Result<[Vec<u8>; 3], ExportError> {
        Ok([self.controller(contract)?, self.meta(contract)?, self.affordance(contract)?])
    }

    fn controller(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let [first, _] = &self.controller;
        let mut graph = begin(first);
        graph.input(GOAL, Element::Int64, &[Dim::Fixed(1)], "The milestone that is gone for.");
        let hidden = add_hidden(&mut graph, &self.controller)?;
        let (inputs, actions) = self.heads.first().map_or((0, 0), |h| (h.inputs, h.bias.len()));
        let weights: Vec<f32> = self.heads.iter().flat_map(DenseLayer::turned).collect();
        let bias: Vec<f32> = self.heads.iter().flat_map(|head| head.bias.clone()).collect();
        check("head.weight", &weights, self.heads.len() * inputs * actions)?;
        check("head.bias", &bias, self.heads.len() * actions)?;
        graph.floats("heads.weight", &[self.heads.len(), inputs * actions], &weights);
        graph.floats("heads.bias", &[self.heads.len(), actions], &bias);
        let own = graph.node("head.row", "Gather", &["heads.weight", GOAL], &[]);
        graph.integers("head.sizes", &[inputs as i64, actions as i64]);
        let own = graph.node("head.weight", "Reshape", &[&own, "head.sizes"], &[]);
        let bias = graph.node("head.bias", "Gather", &["heads.bias", GOAL], &[]);
        let products = graph.node("head.products", "MatMul", &[&hidden, &own], &[]);
        graph.node("values", "Add", &[&products, &bias], &[]);
        let about = "What each action is worth for the goal.";
        graph.output("values", Element::Float, &[Dim::Fixed(1), Dim::Fixed(actions)], about);
        let doc = "Values of actions for a goal.";
        Ok(graph.into_model("controller", doc, &metadata("policy", contract, [])))
    }

    fn meta(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let about = ["meta", "Values of milestones.", "What it is worth to go for each milestone."];
        of_milestones(&self.meta, contract, about, ["values", "Identity"])
    }

    fn affordance(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let likelihood = "How likely each milestone can be reached without another one before.";
        let about = ["affordance", "Affordances of milestones.", likelihood];
        of_milestones(&self.affordance, contract, about, ["likelihoods", "Sigmoid"])
    }
}

fn begin(first: &DenseLayer) -> Graph {
    let mut graph = Graph::default();
    let about = "What is shown of the agent's row, by columns that are 0 or 1.";
    graph.input("shown", Element::Float, &[Dim::Fixed(1), Dim::Fixed(first.inputs)], about);
    graph
}

/// Adds hidden layers over what is shown.
fn add_hidden(graph: &mut Graph, layers: &[DenseLayer]) -> Result<String, ExportError> {
    // Changes nothing, and says what compilers of plans ask for: most of the columns are zero, none is below.
    let mut from = graph.node("lit", "Relu", &["shown"], &[]);
    for (index, layer) in layers.iter().enumerate() {
        let sums = layer.add_to(graph, &format!("layer.{index}"), (&from, layer.inputs))?;
        from = graph.node(&format!("hidden.{index}"), "Relu", &[&sums], &[]);
    }
    Ok(from)
}

/// Writes layers, the last of which has an output for each milestone: what an operator makes of it.
fn of_milestones(
    layers: &[DenseLayer; 3],
    contract: u64,
    [name, doc, about]: [&str; 3],
    [output, operator]: [&str; 2],
) -> Result<Vec<u8>, ExportError> {
    let [first, _, head] = layers;
    let mut graph = begin(first);
    let hidden = add_hidden(&mut graph, &layers[..2])?;
    let sums = head.add_to(&mut graph, "head", (&hidden, head.inputs))?;
    graph.node(output, operator, &[&sums], &[]);
    graph.output(output, Element::Float, &[Dim::Fixed(1), Dim::Fixed(head.bias.len())], about);
    Ok(graph.into_model(name, doc, &metadata("policy", contract, [])))
}

/// Tables of answers, by agents, by what they hold, by places.
#[derive(Clone, Debug, PartialEq)]
pub struct LookupTables {
    /// `[d]`: the cell is the sum of the observation times these, rounded.
    pub cell: Vec<f32>,
    /// `[d]`: the level is the sum of the observation times these.
    pub level: Vec<f32>,
    /// What the level has to reach to be one of the next kind; rising.
    pub levels: Vec<f32>,
    /// `[d]`: what is held is the sum of the observation times these, rounded.
    pub held: Vec<f32>,
    /// `[levels + 1, cells]`: the place.
    pub places: Vec<u32>,
    /// By what is held: its number in the table.
    pub holdings: Vec<u32>,
    /// `[agents, holdings, places, U]`
    pub answers: Vec<f32>,
    /// Agents.
    pub agents: usize,
    /// Actions U.
    pub actions: usize,
}

impl LookupTables {
    /// How many places the table has, and how many kinds of what is held.
    fn sizes(&self) -> [usize; 2] {
        let count = |numbers: &[u32]| numbers.iter().max().map_or(0, |most| *most as usize + 1);
        [count(&self.places), count(&self.holdings)]
    }

    /// Writes them as ONNX: `observation f32 [1, d], agent i64 [1] -> logits f32 [1, U]`.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_onnx(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let [places, holdings] = self.sizes();
        check("table.answers", &self.answers, self.agents * holdings * places * self.actions)?;
        let mut graph = Graph::default();
        let columns = self.cell.len();
        let shape = [Dim::Fixed(1), Dim::Fixed(columns)];
        graph.input("observation", Element::Float, &shape, "the agent's own row");
        graph.input(AGENT_NUMBER, Element::Int64, &[Dim::Fixed(1)], "the agent's number");
        let shape = [Dim::Fixed(1), Dim::Fixed(self.actions)];
        graph.output("logits", Element::Float, &shape, "scores of the actions");
        graph.integers("one", &[1]);
        graph.floats("half", &[1, 1], &[0.5]);

        let cell = rounded(&mut graph, "cell", &self.cell);
        let kind = self.add_kind(&mut graph);
        let place = graph.node("place.number", "Add", &[&cell, &kind], &[]);
        let place = looked_up(&mut graph, "place", &self.places, 1, &place);
        let held = rounded(&mut graph, "held", &self.held);
        let held = looked_up(&mut graph, "holding", &self.holdings, places, &held);
        let firsts: Vec<u32> = (0..self.agents as u32).collect();
        let own = floats(&mut graph, "own", &firsts, holdings * places);
        let own = graph.node("own.first", "Gather", &[&own, AGENT_NUMBER], &[]);
        let within = graph.node("row.within", "Add", &[&place, &held], &[]);
        let row = graph.node("row.number", "Add", &[&within, &own], &[]);
        let row = whole(&mut graph, "row", &row);
        let shape = [self.answers.len() / self.actions, self.actions];
        graph.floats("answers", &shape, &self.answers);
        graph.node("logits", "Gather", &["answers", &row], &[]);
        let doc = "Scores of one agent's actions, looked up by its own row and its number.";
        Ok(graph.into_model("agent", doc, &metadata("policy", contract, [])))
    }

    /// Adds the cells to skip for the kind that the level is of.
    fn add_kind(&self, graph: &mut Graph) -> String {
        let cells = self.places.len() / (self.levels.len() + 1);
        graph.floats("level.weight", &[self.level.len(), 1], &self.level);
        let level = graph.node("level", "MatMul", &["observation", "level.weight"], &[]);
        graph.floats("level.least", &[1, self.levels.len()], &self.levels);
        let reached = graph.node("level.reached", "GreaterOrEqual", &[&level, "level.least"], &[]);
        let to = [Attribute::Int("to", Element::Float.id())];
        let reached = graph.node("level.flags", "Cast", &[&reached], &to);
        let skips = vec![cells as f32; self.levels.len()];
        graph.floats("level.cells", &[self.levels.len(), 1], &skips);
        graph.node("level.skipped", "MatMul", &[&reached, "level.cells"], &[])
    }
}

/// Adds the sum of the observation times some weights, rounded.
fn rounded(graph: &mut Graph, name: &str, weights: &[f32]) -> String {
    let named = |what: &str| format!("{name}.{what}");
    graph.floats(&named("weight"), &[weights.len(), 1], weights);
    let sum = graph.node(&named("sum"), "MatMul", &["observation", &named("weight")], &[]);
    let above = graph.node(&named("above"), "Add", &[&sum, "half"], &[]);
    graph.node(&named("rounded"), "Floor", &[&above], &[])
}

/// Adds a list of whole numbers times a factor, a number a row.
fn floats(graph: &mut Graph, name: &str, numbers: &[u32], factor: usize) -> String {
    let numbers: Vec<f32> =
        numbers.iter().map(|number| (*number as usize * factor) as f32).collect();
    graph.floats(name, &[numbers.len(), 1], &numbers).to_owned()
}

/// Adds the number that such a list has at a place; at the nearest place where there is none, so that every
/// observation has an answer.
fn looked_up(graph: &mut Graph, name: &str, numbers: &[u32], factor: usize, at: &str) -> String {
    let list = floats(graph, &format!("{name}.list"), numbers, factor);
    let (least, most) = (format!("{name}.least"), format!("{name}.most"));
    graph.floats(&least, &[1, 1], &[0.0]);
    graph.floats(&most, &[1, 1], &[numbers.len().saturating_sub(1) as f32]);
    let at = graph.node(&format!("{name}.above"), "Max", &[at, &least], &[]);
    let at = graph.node(&format!("{name}.inside"), "Min", &[&at, &most], &[]);
    let at = whole(graph, name, &at);
    graph.node(&format!("{name}.found"), "Gather", &[&list, &at], &[])
}

/// Adds a number as one that rows are chosen by.
fn whole(graph: &mut Graph, name: &str, number: &str) -> String {
    let to = [Attribute::Int("to", Element::Int64.id())];
    let whole = graph.node(&format!("{name}.whole"), "Cast", &[number], &to);
    graph.node(&format!("{name}.index"), "Reshape", &[&whole, "one"], &[])
}

#[cfg(test)]
mod tests {
    use super::super::skip_tests::{CONTRACT, assert_recorded};
    use super::*;

    #[test]
    fn tables_become_the_recorded_file() {
        let tables = LookupTables {
            cell: vec![1.0, 0.0, 0.0],
            level: vec![0.0, 1.0, 0.0],
            levels: vec![0.25, 0.5],
            held: vec![0.0, 0.0, 1.0],
            places: vec![0, 1, 2, 1, 3, 1],
            holdings: vec![0, 1],
            answers: (0..2 * 2 * 4 * 3).map(|number| number as f32).collect(),
            agents: 2,
            actions: 3,
        };
        assert_recorded("tables_small", &tables.to_onnx(CONTRACT).unwrap());
    }
}
