//! The graphs of agents that decide by their own row, each by one of several networks.

use super::attention::{ExportError, check};
use super::onnx::{Attribute, Dim, Element, Graph};

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
            let named = |what: &str| format!("layer.{index}.{what}");
            let outputs = layer.bias.len();
            check("policy.weight", &layer.weight, layer.inputs * outputs)?;
            check("policy.bias", &layer.bias, outputs)?;
            let mut weight = layer.turned();
            // A network that makes no difference between agents has no weights for their numbers.
            weight.resize(inputs * outputs, 0.0);
            graph.floats(&named("weight"), &[inputs, outputs], &weight);
            graph.floats(&named("bias"), &[outputs], &layer.bias);
            let products =
                graph.node(&named("products"), "MatMul", &[&from, &named("weight")], &[]);
            from = graph.node(&named("sums"), "Add", &[&products, &named("bias")], &[]);
            if index + 1 < layers.len() {
                let slope = Attribute::Float("alpha", self.slope);
                from = graph.node(&format!("hidden.{index}"), "LeakyRelu", &[&from], &[slope]);
            }
            inputs = outputs;
        }
        graph.node("logits", "Identity", &[&from], &[]);
        let metadata = [
            ("sortie.graph", "policy".to_owned()),
            ("sortie.format", "1".to_owned()),
            ("sortie.contract", format!("{contract:016x}")),
        ];
        Ok(graph.into_model("agent", DOC, &metadata))
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

const DOC: &str = "Scores of one agent's actions, by its own row.";

impl OwnRowNetwork {
    /// Actions that it scores.
    pub fn actions(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.bias.len())
    }
}

impl DenseLayer {
    /// `[inputs, outputs]`
    pub(super) fn turned(&self) -> Vec<f32> {
        let column = |input| self.weight.iter().skip(input).step_by(self.inputs);
        (0..self.inputs).flat_map(column).copied().collect()
    }
}
