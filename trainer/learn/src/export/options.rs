//! The graphs of an agent that goes from milestone to milestone: controller, meta-controller, affordances.

use super::attention::{ExportError, check};
use super::onnx::{Dim, Element, Graph};
use super::own_row::DenseLayer;

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
        Ok(graph.into_model("controller", "Values of actions for a goal.", &metadata(contract)))
    }

    fn meta(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let (mut graph, sums, goals) = add_layers(&self.meta)?;
        graph.node("values", "Identity", &[&sums], &[]);
        let about = "What it is worth to go for each milestone.";
        graph.output("values", Element::Float, &[Dim::Fixed(1), Dim::Fixed(goals)], about);
        Ok(graph.into_model("meta", "Values of milestones.", &metadata(contract)))
    }

    fn affordance(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let (mut graph, sums, goals) = add_layers(&self.affordance)?;
        graph.node("likelihoods", "Sigmoid", &[&sums], &[]);
        let about = "How likely each milestone can be reached without another one before.";
        graph.output("likelihoods", Element::Float, &[Dim::Fixed(1), Dim::Fixed(goals)], about);
        Ok(graph.into_model("affordance", "Affordances of milestones.", &metadata(contract)))
    }
}

fn metadata(contract: u64) -> [(&'static str, String); 3] {
    [
        ("sortie.graph", "policy".to_owned()),
        ("sortie.format", "1".to_owned()),
        ("sortie.contract", format!("{contract:016x}")),
    ]
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
        let sums = add_layer(graph, &format!("layer.{index}"), &from, layer)?;
        from = graph.node(&format!("hidden.{index}"), "Relu", &[&sums], &[]);
    }
    Ok(from)
}

/// A graph of hidden layers and a head: the head's sums and how many they are.
fn add_layers(layers: &[DenseLayer; 3]) -> Result<(Graph, String, usize), ExportError> {
    let [first, second, head] = layers;
    let mut graph = begin(first);
    let hidden = add_hidden(&mut graph, &[first.clone(), second.clone()])?;
    let sums = add_layer(&mut graph, "head", &hidden, head)?;
    Ok((graph, sums, head.bias.len()))
}

fn add_layer(
    graph: &mut Graph,
    name: &str,
    from: &str,
    layer: &DenseLayer,
) -> Result<String, ExportError> {
    let named = |what: &str| format!("{name}.{what}");
    let outputs = layer.bias.len();
    check("option.weight", &layer.weight, layer.inputs * outputs)?;
    check("option.bias", &layer.bias, outputs)?;
    graph.floats(&named("weight"), &[layer.inputs, outputs], &layer.turned());
    graph.floats(&named("bias"), &[outputs], &layer.bias);
    let products = graph.node(&named("products"), "MatMul", &[from, &named("weight")], &[]);
    Ok(graph.node(&named("sums"), "Add", &[&products, &named("bias")], &[]))
}
