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
    /// Its layers: the first takes the first features of a row, the last scores the first actions.
    pub layers: Vec<DenseLayer>,
    /// By agents that decide by it, `[width]`: what stands for the first layer's biases. Empty where it is the same for
    /// all; the agents follow each other.
    pub first_biases: Vec<Vec<f32>>,
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

    /// Whether graphs are told which agent decides: all are, where any makes a difference of it.
    pub fn told_number(&self) -> bool {
        self.networks.iter().any(|network| !network.first_biases.is_empty())
    }

    /// Writes one as ONNX: `observation f32 [1, d] -> logits f32 [1, U]`, with the input `agent i64 [1]` where graphs
    /// are told who decides.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_onnx(&self, network: usize, contract: u64) -> Result<Vec<u8>, ExportError> {
        let mut graph = Graph::default();
        let one = Dim::Fixed(1);
        let OwnRowNetwork { layers, .. } = &self.networks[network];
        let [features, actions] = self.networks[network].sizes();
        let row = "The agent's own row, as far as it sees.";
        graph.input("observation", Element::Float, &[one, Dim::Fixed(features)], row);
        if self.told_number() {
            graph.input(AGENT_NUMBER, Element::Int64, &[one], "The agent's number, from 0.");
        }
        let scores = "A score for every action, not masked by availability.";
        graph.output("logits", Element::Float, &[one, Dim::Fixed(actions)], scores);
        let mut from = "observation".to_owned();
        for (index, layer) in layers.iter().enumerate() {
            let named = |what: &str| format!("layer.{index}.{what}");
            check("policy.weight", &layer.weight, layer.inputs * layer.bias.len())?;
            graph.floats(&named("weight"), &[layer.inputs, layer.bias.len()], &layer.turned());
            let products =
                graph.node(&named("products"), "MatMul", &[&from, &named("weight")], &[]);
            let bias = if index == 0 && self.told_number() {
                self.add_biases(&mut graph, network, &named("biases"))?
            } else {
                check("policy.bias", &layer.bias, layer.bias.len())?;
                graph.floats(&named("bias"), &[layer.bias.len()], &layer.bias).to_owned()
            };
            from = graph.node(&named("sums"), "Add", &[&products, &bias], &[]);
            if index + 1 < layers.len() {
                let slope = Attribute::Float("alpha", self.slope);
                from = graph.node(&format!("hidden.{index}"), "LeakyRelu", &[&from], &[slope]);
            }
        }
        graph.node("logits", "Identity", &[&from], &[]);
        let metadata = [
            ("sortie.graph", "policy".to_owned()),
            ("sortie.format", "1".to_owned()),
            ("sortie.contract", format!("{contract:016x}")),
        ];
        Ok(graph.into_model("agent", DOC, &metadata))
    }

    /// Adds the first layer's biases, a row for every agent of the team, and takes that of the agent that decides.
    fn add_biases(
        &self,
        graph: &mut Graph,
        network: usize,
        name: &str,
    ) -> Result<String, ExportError> {
        let OwnRowNetwork { layers, first_biases } = &self.networks[network];
        let same = layers.first().map_or(&[][..], |layer| &layer.bias);
        let mut own = first_biases.iter();
        let rows = self.network_of.iter().map(|of| match *of == network {
            true => own.next().map_or(same, Vec::as_slice),
            // Nobody else decides by this network.
            false => same,
        });
        let biases: Vec<f32> = rows.flatten().copied().collect();
        let agents = self.network_of.len();
        check("policy.bias", &biases, agents * same.len())?;
        graph.floats(name, &[agents, same.len()], &biases);
        Ok(graph.node(&format!("{name}.own"), "Gather", &[name, AGENT_NUMBER], &[]))
    }
}

const DOC: &str = "Scores of one agent's actions, by its own row.";

impl OwnRowNetwork {
    /// Features that it takes, and actions that it scores.
    pub fn sizes(&self) -> [usize; 2] {
        let ends = (self.layers.first(), self.layers.last());
        [ends.0.map_or(0, |layer| layer.inputs), ends.1.map_or(0, |layer| layer.bias.len())]
    }
}

impl DenseLayer {
    /// `[inputs, outputs]`
    fn turned(&self) -> Vec<f32> {
        let column = |input| self.weight.iter().skip(input).step_by(self.inputs);
        (0..self.inputs).flat_map(column).copied().collect()
    }
}
