//! `agent.onnx` of agents that decide by their own row, each by one of several networks.
//!
//! One graph holds them all: it is told the agent's number, and takes of every layer's sums those of the agent's network.

use super::attention::{ExportError, check};
use super::onnx::{Attribute, Dim, Element, Graph};

/// The input with the agent's number.
pub const AGENT_NUMBER: &str = "agent";

/// Networks of dense layers over an agent's own row, leaky ReLU between them.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnRowNetworks {
    /// Numbers d of a row; a network that takes fewer takes the first of them.
    pub features: usize,
    /// Actions U; those that a network does not know score 0.
    pub actions: usize,
    /// What leaky ReLU makes of numbers below zero.
    pub slope: f32,
    /// By agents: which network is its.
    pub network_of: Vec<usize>,
    /// By agents, `[width]`: the biases of its first layer.
    pub first_biases: Vec<Vec<f32>>,
    /// Their layers, as many in each.
    pub networks: Vec<Vec<DenseLayer>>,
}

/// A layer; the first has its biases by agents.
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
    /// Writes them as ONNX: `observation f32 [1, d], agent i64 [1] -> logits f32 [1, U]`.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_onnx(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let mut graph = Graph::default();
        let one = Dim::Fixed(1);
        let row = "The agent's own row, zeros behind what it sees.";
        graph.input("observation", Element::Float, &[one, Dim::Fixed(self.features)], row);
        graph.input(AGENT_NUMBER, Element::Int64, &[one], "The agent's number, from 0.");
        let scores = "A score for every action, not masked by availability.";
        graph.output("logits", Element::Float, &[one, Dim::Fixed(self.actions)], scores);
        self.add_network_of(&mut graph);
        let mut from = "observation".to_owned();
        let mut inputs = self.features;
        let layers = self.networks.iter().map(Vec::len).max().unwrap_or(0);
        for layer in 0..layers {
            let last = layer + 1 == layers;
            let outputs = if last { self.actions } else { self.width(layer) };
            from = self.add_layer(&mut graph, layer, [inputs, outputs], &from)?;
            inputs = outputs;
            if last {
                graph.node("logits", "Identity", &[&from], &[]);
            } else {
                let slope = Attribute::Float("alpha", self.slope);
                from = graph.node(&format!("hidden.{layer}"), "LeakyRelu", &[&from], &[slope]);
            }
        }
        let metadata = [
            ("sortie.graph", "policy".to_owned()),
            ("sortie.format", "1".to_owned()),
            ("sortie.contract", format!("{contract:016x}")),
        ];
        Ok(graph.into_model("agent", DOC, &metadata))
    }

    fn width(&self, layer: usize) -> usize {
        let widths = self.networks.iter().filter_map(|layers| layers.get(layer));
        widths.map(|layer| layer.bias.len()).max().unwrap_or(0)
    }

    /// Looks up which network is the agent's, where there are several.
    fn add_network_of(&self, graph: &mut Graph) {
        if self.networks.len() > 1 {
            let numbers: Vec<i64> = self.network_of.iter().map(|network| *network as i64).collect();
            graph.integers("network_of", &numbers);
            graph.node("network", "Gather", &["network_of", AGENT_NUMBER], &[]);
        }
    }

    /// Adds a layer of all networks side by side, of which the agent's is taken; returns the name of its sums.
    fn add_layer(
        &self,
        graph: &mut Graph,
        layer: usize,
        [inputs, outputs]: [usize; 2],
        from: &str,
    ) -> Result<String, ExportError> {
        let count = self.networks.len();
        let named = |what: &str| format!("layer.{layer}.{what}");
        let layers = || self.networks.iter().filter_map(|layers| layers.get(layer));
        let weight: Vec<f32> = (0..inputs)
            .flat_map(|input| layers().flat_map(move |layer| layer.column(input, outputs)))
            .collect();
        check("policy.weight", &weight, inputs * outputs * count)?;
        graph.floats(&named("weight"), &[inputs, outputs * count], &weight);
        let mut sums = graph.node(&named("products"), "MatMul", &[from, &named("weight")], &[]);
        if layer > 0 {
            let bias: Vec<f32> = layers().flat_map(|layer| filled(&layer.bias, outputs)).collect();
            check("policy.bias", &bias, outputs * count)?;
            graph.floats(&named("bias"), &[outputs * count], &bias);
            sums = graph.node(&named("sums"), "Add", &[&sums, &named("bias")], &[]);
        }
        if count > 1 {
            graph.integers(&named("sizes"), &[count as i64, outputs as i64]);
            let all = graph.node(&named("all"), "Reshape", &[&sums, &named("sizes")], &[]);
            sums = graph.node(&named("own"), "Gather", &[&all, "network"], &[]);
        }
        if layer == 0 {
            let biases: Vec<f32> =
                self.first_biases.iter().flat_map(|bias| filled(bias, outputs)).collect();
            check("policy.bias", &biases, outputs * self.network_of.len())?;
            graph.floats(&named("biases"), &[self.network_of.len(), outputs], &biases);
            let biases = [&named("biases"), AGENT_NUMBER];
            let bias = graph.node(&named("bias"), "Gather", &biases, &[]);
            sums = graph.node(&named("sums"), "Add", &[&sums, &bias], &[]);
        }
        Ok(sums)
    }
}

const DOC: &str = "Scores of one agent's actions, by its own row and its number.";

impl DenseLayer {
    /// The weights of an input, zeros where the layer has none.
    fn column(&self, input: usize, outputs: usize) -> impl Iterator<Item = f32> + '_ {
        let rows = self.weight.chunks_exact(self.inputs);
        let weights = rows.map(move |row| row.get(input).copied().unwrap_or(0.0));
        weights.chain(std::iter::repeat(0.0)).take(outputs)
    }
}

/// Numbers, and zeros behind them.
fn filled(numbers: &[f32], length: usize) -> impl Iterator<Item = f32> + '_ {
    numbers.iter().copied().chain(std::iter::repeat(0.0)).take(length)
}
