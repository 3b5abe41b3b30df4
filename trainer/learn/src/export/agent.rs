//! `agent.onnx`: the utility network of one agent, with its own query only; of an agent that remembers, with a gated
//! recurrent unit between base and head. And `allocator_team_value.onnx`: what a team at a subtask is worth.

use super::attention::{
    AttentionNetwork, ExportError, Inputs, Layer, add_base, add_network, add_utilities, axis, layer,
};
use super::onnx::{Attribute, Dim, Element, Graph, metadata};

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
    Ok(graph.into_model("agent", DOC, &agent_metadata(network)))
}

const INPUTS: Inputs<'_> = Inputs { rows: "entities", own: "self_index", visible: "visible" };

/// What every agent's graph says of itself.
const DOC: &str = "Utilities of one agent. Masked entities have no influence; an agent that sees \
                              nothing, not even itself, gets the utilities of its biases.";

/// A graph with the inputs and the output that every agent has.
fn begin(network: &AgentNetwork<'_>) -> Result<Graph, ExportError> {
    let layers = &network.layers;
    let last_actions = if network.append_last_action { layers.outputs } else { 0 };
    let (want, got) = (network.features + last_actions, layers.inputs);
    if want != got {
        return Err(ExportError::Columns { want, got });
    }
    let mut graph = Graph::default();
    let (n, one) = (Dim::Symbol("N"), Dim::Fixed(1));
    let rows = "Features of every entity; agents' rows end with the one-hot of their last action.";
    graph.input("entities", Element::Float, &[n, Dim::Fixed(layers.inputs)], rows);
    let own = "The row of the agent that decides; it forms the query even where it is not visible.";
    graph.input("self_index", Element::Int64, &[one], own);
    graph.input("visible", Element::Bool, &[n], "True where the agent may attend to the entity.");
    let utilities = "One utility per action, not masked by availability.";
    graph.output("utilities", Element::Float, &[Dim::Fixed(layers.outputs)], utilities);
    Ok(graph)
}

fn agent_metadata(network: &AgentNetwork<'_>) -> Vec<(&'static str, String)> {
    let sizes = [
        ("sortie.features", network.features),
        ("sortie.actions", network.layers.outputs),
        ("sortie.append_last_action", network.append_last_action.into()),
    ];
    let mut metadata = metadata("agent", network.contract, sizes);
    if let Some(head) = network.layers.pointing {
        let range = |first: usize, count: usize| format!("{first}..{}", first + count);
        metadata.push(("sortie.targets", range(head.first_entity, head.count)));
        if let Some(pairs) = head.pairs {
            let columns = range(pairs.first, head.count * pairs.features);
            metadata.push(("sortie.pairs", columns));
        }
    }
    metadata
}

/// A gated recurrent unit in PyTorch's packing: its outputs are the gates r, z and n, R each.
#[derive(Clone, Copy, Debug)]
pub struct GruCell<'a> {
    /// R inputs to 3 R outputs.
    pub input: Layer<'a>,
    /// R numbers of state to 3 R outputs.
    pub recurrent: Layer<'a>,
}

/// The utility network of an agent that remembers (dissertation section 5.2).
#[derive(Clone, Copy, Debug)]
pub struct RecurrentAgent<'a> {
    /// Everything but the unit; the state is as wide as the layer before the head.
    pub agent: AgentNetwork<'a>,
    /// Whether a ReLU follows the attention: REFIL's agents have none there, ALMA's have one.
    pub attention_relu: bool,
    /// The unit.
    pub gru: GruCell<'a>,
}

/// Writes the network as ONNX: `entities [N, D], self_index [1], visible [N], h_in [R] -> utilities [U],
/// h_out [R]`.
///
/// The state is the caller's to keep: zeros where an episode begins, then `h_out` of the step before.
pub fn recurrent_agent_onnx(network: &RecurrentAgent<'_>) -> Result<Vec<u8>, ExportError> {
    let RecurrentAgent { agent, attention_relu, gru } = network;
    let mut graph = begin(agent)?;
    let size = agent.layers.base;
    let state = [Dim::Fixed(size)];
    graph.input("h_in", Element::Float, &state, "State after the step before, zeros at first.");
    graph.output("h_out", Element::Float, &state, "State after this step.");
    let (embedding, base) = add_base(&mut graph, &agent.layers, INPUTS, *attention_relu)?;
    let state = add_gru(&mut graph, gru, size, &base)?;
    add_utilities(&mut graph, &agent.layers, INPUTS, [&embedding, &state], "utilities")?;
    let mut metadata = agent_metadata(agent);
    metadata.push(("sortie.hidden", size.to_string()));
    Ok(graph.into_model("agent", DOC, &metadata))
}

/// Adds r = σ(..), z = σ(..), n = tanh(i + r h), n + z (h - n); returns the new state's name, `[1, R]`.
fn add_gru(
    graph: &mut Graph,
    cell: &GruCell<'_>,
    size: usize,
    input: &str,
) -> Result<String, ExportError> {
    let row = graph.integers("gru.row", &[1, size as i64]);
    let state = graph.node("gru.state", "Reshape", &["h_in", row], &[]);
    let gates = [size, 3 * size];
    let from_input = layer(graph, "gru.input", input, &cell.input, gates)?;
    let from_state = layer(graph, "gru.recurrent", &state, &cell.recurrent, gates)?;
    let [reset_i, update_i, new_i] = split(graph, &from_input, size);
    let [reset_h, update_h, new_h] = split(graph, &from_state, size);
    let mut gate = |name: &str, a: &str, b: &str| {
        let sum = graph.node(&format!("gru.{name}.sum"), "Add", &[a, b], &[]);
        graph.node(&format!("gru.{name}"), "Sigmoid", &[&sum], &[])
    };
    let reset = gate("reset", &reset_i, &reset_h);
    let update = gate("update", &update_i, &update_h);
    let kept = graph.node("gru.kept", "Mul", &[&reset, &new_h], &[]);
    let sum = graph.node("gru.new.sum", "Add", &[&new_i, &kept], &[]);
    let new = graph.node("gru.new", "Tanh", &[&sum], &[]);
    let distance = graph.node("gru.distance", "Sub", &[&state, &new], &[]);
    let step = graph.node("gru.step", "Mul", &[&update, &distance], &[]);
    let next = graph.node("gru.next", "Add", &[&new, &step], &[]);
    let shape = graph.integers("h_out.shape", &[size as i64]);
    graph.node("h_out", "Reshape", &[&next, shape], &[]);
    Ok(next)
}

/// The three gates side by side in `packed` `[1, 3 R]`.
fn split(graph: &mut Graph, packed: &str, size: usize) -> [String; 3] {
    let columns = format!("{packed}.axis");
    graph.integers(&columns, &[1]);
    [("reset", 0), ("update", 1), ("new", 2)].map(|(gate, place)| {
        let name = format!("{packed}.{gate}");
        let (start, end) = (format!("{name}.start"), format!("{name}.end"));
        graph.integers(&start, &[(place * size) as i64]);
        graph.integers(&end, &[((place + 1) * size) as i64]);
        graph.node(&name, "Slice", &[packed, &start, &end, &columns], &[])
    })
}

/// The team-value network of an allocator.
#[derive(Clone, Copy, Debug)]
pub struct TeamValueExport<'a> {
    /// Features d of an entity.
    pub features: usize,
    /// Columns F of the relation of an entity to the subtask.
    pub relations: usize,
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// The layers: d features, the subtask's flag, team flag and F relations in, one value out.
    pub layers: AttentionNetwork<'a>,
}

/// Writes the network as ONNX: `entities [N, d], present [N], is_agent [N], in_task [N], open [N],
/// team [N], relation [N, F] -> value [1]`.
///
/// The first row of the subtask forms the query, which attends to the present agents and to the
/// present rows of open subtasks.
pub fn team_value_onnx(network: &TeamValueExport<'_>) -> Result<Vec<u8>, ExportError> {
    let TeamValueExport { features, relations, layers, .. } = network;
    let (want, got) = (features + 2 + relations, layers.inputs);
    if want != got {
        return Err(ExportError::Columns { want, got });
    }
    let mut graph = Graph::default();
    declare_team_value(&mut graph, *features, *relations);
    let inputs = Inputs { rows: "rows", own: "own", visible: "visible" };
    add_inputs(&mut graph);
    add_network(&mut graph, layers, inputs, "value")?;
    let sizes = [("sortie.features", *features), ("sortie.relations", *relations)];
    let metadata = metadata("team-value", network.contract, sizes);
    let doc = "The value of giving a team, which may be empty, to a subtask. Absent entities and those of \
               closed subtasks have no influence.";
    Ok(graph.into_model("allocator_team_value", doc, &metadata))
}

fn declare_team_value(graph: &mut Graph, features: usize, relations: usize) {
    let n = Dim::Symbol("N");
    let rows = "Features of every entity.";
    graph.input("entities", Element::Float, &[n, Dim::Fixed(features)], rows);
    for (name, doc) in [
        ("present", "True where the entity exists."),
        ("is_agent", "True for agents."),
        ("in_task", "True for the subtask's own row; it forms the query."),
        ("open", "True for rows of open subtasks, the one in question among them."),
        ("team", "True for the agents of the team."),
    ] {
        graph.input(name, Element::Bool, &[n], doc);
    }
    let doc = "How each entity relates to the subtask; zeros in the subtask's own row.";
    graph.input("relation", Element::Float, &[n, Dim::Fixed(relations)], doc);
    graph.output("value", Element::Float, &[Dim::Fixed(1)], "The value of the team.");
}

/// Joins the columns, finds the own row and what it attends to.
fn add_inputs(graph: &mut Graph) {
    let column = graph.integers("rows.column", &[1]);
    let to_float = [Attribute::Int("to", Element::Float.id())];
    let mut flag = |name: &str, mask: &str| {
        let number = graph.node(&format!("{name}.number"), "Cast", &[mask], &to_float);
        (graph.node(name, "Unsqueeze", &[&number, column], &[]), number)
    };
    let (own, own_number) = flag("rows.own", "in_task");
    let (team, _) = flag("rows.team", "team");
    graph.node("rows", "Concat", &["entities", &own, &team, "relation"], &[axis(1)]);
    graph.node("own", "ArgMax", &[&own_number], &[axis(0), Attribute::Int("keepdims", 1)]);
    graph.node("visible.kind", "Or", &["is_agent", "open"], &[]);
    graph.node("visible", "And", &["present", "visible.kind"], &[]);
}

#[cfg(test)]
mod recurrent_tests {
    use super::*;
    use crate::export::attention::{AttentionNetwork, Layout, Matrix};

    fn file(path: &str) -> Vec<u8> {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/");
        std::fs::read(format!("{root}{path}")).unwrap()
    }

    /// The recorded network `agent-gru-attn-0`: D = 9, of which 4 are last actions; width 16, 4 heads, R = 8.
    fn export(change: impl FnOnce(&mut RecurrentAgent<'_>)) -> Result<Vec<u8>, ExportError> {
        let recorded: serde_json::Value =
            serde_json::from_slice(&file("networks/agent_gru_attn.json")).unwrap();
        let tensor = |name: &str| -> Vec<f32> {
            let data = recorded["cases"][0]["weights"][name]["data"].as_array().unwrap();
            data.iter().map(|value| value.as_f64().unwrap() as f32).collect()
        };
        let names = ["fc1", "attn.out_trans", "fc2", "fc3"];
        let layers = names.map(|n| (tensor(&format!("{n}.weight")), tensor(&format!("{n}.bias"))));
        let unit = ["ih", "hh"].map(|part| {
            (tensor(&format!("rnn.weight_{part}")), tensor(&format!("rnn.bias_{part}")))
        });
        let attention_in = tensor("attn.in_trans.weight");
        fn matrix(values: &[f32]) -> Matrix<'_> {
            Matrix { values, layout: Layout::OutputsFirst }
        }
        fn layer((weight, bias): &(Vec<f32>, Vec<f32>)) -> Layer<'_> {
            Layer { weight: matrix(weight), bias }
        }
        let [fc1, attention_out, fc2, head] = layers.each_ref().map(layer);
        let [input, recurrent] = unit.each_ref().map(layer);
        let layers = AttentionNetwork {
            inputs: 9,
            width: 16,
            heads: 4,
            base: 8,
            outputs: 4,
            fc1,
            attention_in: matrix(&attention_in),
            attention_out,
            skip: None,
            fc2: Some(fc2),
            head,
            pointing: None,
        };
        let agent = AgentNetwork { features: 5, append_last_action: true, contract: 0, layers };
        let gru = GruCell { input, recurrent };
        let mut network = RecurrentAgent { agent, attention_relu: false, gru };
        change(&mut network);
        recurrent_agent_onnx(&network)
    }

    /// Random weights at sizes that no tile fits: D = 7, width 20, 5 heads, R = 9, U = 3.
    fn odd_sizes() -> Vec<u8> {
        let mut state = 7_u32;
        let mut tensor = |count: usize| -> Vec<f32> {
            let mut next = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 24) as f32 - 0.5
            };
            (0..count).map(|_| next()).collect()
        };
        fn matrix(values: &[f32]) -> Matrix<'_> {
            Matrix { values, layout: Layout::InputsFirst }
        }
        fn layer((weight, bias): &(Vec<f32>, Vec<f32>)) -> Layer<'_> {
            Layer { weight: matrix(weight), bias }
        }
        let sizes = [(7, 20), (20, 20), (20, 9), (9, 27), (9, 27), (9, 3)];
        let layers = sizes.map(|(inputs, outputs)| (tensor(inputs * outputs), tensor(outputs)));
        let [fc1, attention_out, fc2, input, recurrent, head] = layers.each_ref().map(layer);
        let attention_in = tensor(20 * 60);
        let layers = AttentionNetwork {
            inputs: 7,
            width: 20,
            heads: 5,
            base: 9,
            outputs: 3,
            fc1,
            attention_in: matrix(&attention_in),
            attention_out,
            skip: None,
            fc2: Some(fc2),
            head,
            pointing: None,
        };
        let agent = AgentNetwork { features: 7, append_last_action: false, contract: 0, layers };
        let gru = GruCell { input, recurrent };
        recurrent_agent_onnx(&RecurrentAgent { agent, attention_relu: true, gru }).unwrap()
    }

    #[test]
    fn odd_sizes_become_the_recorded_file() {
        let written = odd_sizes();
        assert!(written == file("onnx/agent_gru_odd_sizes.onnx"), "the exported bytes changed");
    }

    #[test]
    fn the_recorded_network_becomes_the_recorded_file() {
        let written = export(|_| {}).unwrap();
        assert!(written == file("onnx/agent_gru_small.onnx"), "the exported bytes changed");
    }

    #[test]
    fn units_that_do_not_fit_are_refused() {
        let error = export(|network| network.gru.recurrent.bias = &[0.0; 8]).unwrap_err();
        let text = "`gru.recurrent` has 8 values, the network's shape asks for 24";
        assert_eq!(error.to_string(), text);
        let error = export(|network| network.gru.input.bias = &[f32::INFINITY; 24]).unwrap_err();
        assert_eq!(error, ExportError::NonFinite { tensor: "gru.input".to_owned() });
    }
}

#[cfg(test)]
mod tests {
    use safetensors::SafeTensors;

    use super::*;
    use crate::export::attention::{Layer, Layout, Matrix};

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
                pointing: None,
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
        assert_eq!(error, ExportError::NonFinite { tensor: "fc1".to_owned() });
    }
}
