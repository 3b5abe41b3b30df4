//! `agent.onnx`: the utility network of one agent, with its own query only.

use super::attention::{AttentionNetwork, ExportError, Inputs, add_network};
use super::onnx::{Dim, Element, Graph};

/// The utility network of an agent.
#[derive(Clone, Copy, Debug)]
pub struct AgentNetwork<'a> {
    /// Features d of an entity.
    pub features: usize,
    /// Whether the input has U more columns, the last action's one-hot.
    pub append_last_action: bool,
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// The layers; an output per action.
    pub layers: AttentionNetwork<'a>,
}

/// Writes the network as ONNX: `entities [N, D], self_index [1], visible [N] -> utilities [U]`.
pub fn agent_onnx(network: &AgentNetwork<'_>) -> Result<Vec<u8>, ExportError> {
    let mut graph = begin(network)?;
    add_network(&mut graph, &network.layers, INPUTS, "utilities")?;
    Ok(graph.into_model("agent", DOC, &metadata(network)))
}

/// The inputs of every agent's graph.
pub(super) const INPUTS: Inputs<'_> =
    Inputs { rows: "entities", own: Some("self_index"), visible: "visible" };

/// What every agent's graph says of itself.
pub(super) const DOC: &str = "Utilities of one agent. Masked entities have no influence; an agent that sees \
                              nothing, not even itself, gets the utilities of its biases.";

/// A graph with the inputs and the output that every agent has.
pub(super) fn begin(network: &AgentNetwork<'_>) -> Result<Graph, ExportError> {
    let layers = &network.layers;
    let last_actions = if network.append_last_action { layers.outputs } else { 0 };
    let (want, got) = (network.features + last_actions, layers.inputs);
    if want != got {
        return Err(ExportError::Columns { want, got });
    }
    let mut graph = Graph::default();
    declare(&mut graph, layers.inputs, layers.outputs);
    Ok(graph)
}

/// The metadata that every agent has.
pub(super) fn metadata(network: &AgentNetwork<'_>) -> [(&'static str, String); 6] {
    [
        ("sortie.graph", "agent".to_owned()),
        ("sortie.format", "1".to_owned()),
        ("sortie.contract", format!("{:016x}", network.contract)),
        ("sortie.features", network.features.to_string()),
        ("sortie.actions", network.layers.outputs.to_string()),
        ("sortie.append_last_action", u8::from(network.append_last_action).to_string()),
    ]
}

fn declare(graph: &mut Graph, inputs: usize, actions: usize) {
    let (n, one) = (Dim::Symbol("N"), Dim::Fixed(1));
    let rows = "Features of every entity; agents' rows end with the one-hot of their last action.";
    graph.input("entities", Element::Float, &[n, Dim::Fixed(inputs)], rows);
    let own = "The row of the agent that decides; it forms the query even where it is not visible.";
    graph.input("self_index", Element::Int64, &[one], own);
    graph.input("visible", Element::Bool, &[n], "True where the agent may attend to the entity.");
    let utilities = "One utility per action, not masked by availability.";
    graph.output("utilities", Element::Float, &[Dim::Fixed(actions)], utilities);
}

#[cfg(test)]
mod tests {
    use safetensors::SafeTensors;

    use super::super::attention::{Layer, Layout, Matrix};
    use super::*;

    fn file(path: &str) -> Vec<u8> {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/");
        std::fs::read(format!("{root}{path}")).unwrap()
    }

    /// Tensors of the recorded network by name.
    struct Recorded(Vec<u8>);

    impl Recorded {
        fn tensor(&self, name: &str) -> Vec<f32> {
            let file = SafeTensors::deserialize(&self.0).unwrap();
            let data = file.tensor(&format!("w/{name}")).unwrap().data().to_vec();
            data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
        }
    }

    fn outputs_first(values: &[f32]) -> Matrix<'_> {
        Matrix { values, layout: Layout::OutputsFirst }
    }

    fn export(change: impl FnOnce(&mut AgentNetwork<'_>)) -> Result<Vec<u8>, ExportError> {
        let recorded = Recorded(file("networks/agent_ff_default.safetensors"));
        let names = ["_base.fc1", "_base.attn.out_trans", "_base.fc2", "_head.fc_out"];
        let [fc1, attention_out, fc2, head] = names.map(|name| {
            let part = |part: &str| recorded.tensor(&format!("{name}.{part}"));
            (part("weight"), part("bias"))
        });
        let attention_in = recorded.tensor("_base.attn.in_trans.weight");
        let [fc1, attention_out, fc2, head] = [&fc1, &attention_out, &fc2, &head]
            .map(|(weight, bias)| Layer { weight: outputs_first(weight), bias });
        let mut network = AgentNetwork {
            features: 58,
            append_last_action: true,
            contract: 0,
            layers: AttentionNetwork {
                inputs: 70,
                width: 128,
                heads: 4,
                base: 64,
                outputs: 12,
                fc1,
                attention_in: outputs_first(&attention_in),
                attention_out,
                skip: None,
                fc2: Some(fc2),
                head,
            },
        };
        change(&mut network);
        agent_onnx(&network)
    }

    #[test]
    fn the_recorded_network_becomes_the_recorded_file() {
        let written = export(|_| {}).unwrap();
        assert!(written == file("onnx/agent_ff_default.onnx"), "the exported bytes changed");
    }

    #[test]
    fn the_layout_of_a_matrix_does_not_matter() {
        let want = export(|_| {}).unwrap();
        let transposed = |values: &[f32]| -> Vec<f32> {
            (0..64).flat_map(|input| values.iter().skip(input).step_by(64)).copied().collect()
        };
        let head = Recorded(file("networks/agent_ff_default.safetensors"));
        let head = transposed(&head.tensor("_head.fc_out.weight"));
        let written = export(|network| {
            // The matrix outlives the network only by a leak, which a test can afford.
            let values = head.clone().leak();
            network.layers.head.weight = Matrix { values, layout: Layout::InputsFirst };
        });
        assert!(written.unwrap() == want);
    }

    #[test]
    fn networks_that_do_not_fit_are_refused() {
        let error = export(|network| network.layers.base = 32).unwrap_err();
        assert_eq!(error.to_string(), "`fc2` has 64 values, the network's shape asks for 32");
        assert_eq!(
            export(|n| n.layers.heads = 3),
            Err(ExportError::Heads { heads: 3, width: 128 })
        );
        assert_eq!(
            export(|n| n.layers.heads = 0),
            Err(ExportError::Heads { heads: 0, width: 128 })
        );
        let error = export(|network| network.layers.fc1.bias = &[f32::NAN; 128]).unwrap_err();
        assert_eq!(error, ExportError::NonFinite { tensor: "fc1" });
    }
}
