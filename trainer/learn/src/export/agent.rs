//! `agent.onnx`: the utility network of one agent, with its own query only.

use std::borrow::Cow;

use super::onnx::{Attribute, Dim, Element, Graph};

/// Stands for minus infinity among logits; the softmax of a row that holds nothing else stays finite.
const BLOCKED: f32 = -1.0e30;

/// How a matrix is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `[outputs, inputs]`, as PyTorch does.
    OutputsFirst,
    /// `[inputs, outputs]`.
    InputsFirst,
}

/// A matrix of weights.
#[derive(Clone, Copy, Debug)]
pub struct Matrix<'a> {
    /// The weights, row-major.
    pub values: &'a [f32],
    /// Whether a row belongs to an output or an input.
    pub layout: Layout,
}

/// A matrix and its bias.
#[derive(Clone, Copy, Debug)]
pub struct Layer<'a> {
    /// The weights.
    pub weight: Matrix<'a>,
    /// The bias `[outputs]`.
    pub bias: &'a [f32],
}

/// A feed-forward utility network (dissertation section 7.3): embed, attend, two layers.
#[derive(Clone, Copy, Debug)]
pub struct AgentNetwork<'a> {
    /// Features d of an entity.
    pub features: usize,
    /// Actions U.
    pub actions: usize,
    /// Whether the input has U more columns, the last action's one-hot.
    pub append_last_action: bool,
    /// Width E of the embedding and the attention.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
    /// Width R of the layer before the head.
    pub base: usize,
    /// D to E.
    pub fc1: Layer<'a>,
    /// E to 3 E, without bias: query, key, value.
    pub attention_in: Matrix<'a>,
    /// E to E.
    pub attention_out: Layer<'a>,
    /// E to R.
    pub fc2: Layer<'a>,
    /// R to U.
    pub head: Layer<'a>,
    /// Hash of the contract that it was trained for.
    pub contract: u64,
}

/// Why a network cannot be exported.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A tensor does not have the size that the network's shape asks for.
    #[error("`{tensor}` has {got} values, the network's shape asks for {want}")]
    WrongLength {
        /// The tensor.
        tensor: &'static str,
        /// Values asked for.
        want: usize,
        /// Values given.
        got: usize,
    },
    /// A tensor holds a value that is not a finite number: training diverged.
    #[error("`{tensor}` holds a value that is not finite: the training diverged")]
    NonFinite {
        /// The tensor.
        tensor: &'static str,
    },
    /// The heads do not divide the width.
    #[error("{heads} heads do not divide the width {width}")]
    Heads {
        /// Attention heads.
        heads: usize,
        /// Width of the attention.
        width: usize,
    },
}

/// Writes the network as ONNX: `entities [N, D], self_index [1], visible [N] -> utilities [U]`.
pub fn agent_onnx(network: &AgentNetwork<'_>) -> Result<Vec<u8>, ExportError> {
    let AgentNetwork { features, actions, width, heads, base, .. } = *network;
    if heads == 0 || !width.is_multiple_of(heads) {
        return Err(ExportError::Heads { heads, width });
    }
    let inputs = features + if network.append_last_action { actions } else { 0 };
    let mut graph = Graph::default();
    declare(&mut graph, inputs, actions);
    let fc1 = layer(&mut graph, "fc1", "entities", &network.fc1, [inputs, width])?;
    let embedding = graph.node("fc1.relu", "Relu", &[&fc1], &[]);
    let attended = attention(&mut graph, network, &embedding)?;
    let attended = graph.node("attention.relu", "Relu", &[&attended], &[]);
    let fc2 = layer(&mut graph, "fc2", &attended, &network.fc2, [width, base])?;
    let fc2 = graph.node("fc2.relu", "Relu", &[&fc2], &[]);
    let head = layer(&mut graph, "head", &fc2, &network.head, [base, actions])?;
    let shape = graph.integers("utilities.shape", &[actions as i64]);
    graph.node("utilities", "Reshape", &[&head, shape], &[]);
    let metadata = [
        ("sortie.graph", "agent".to_owned()),
        ("sortie.format", "1".to_owned()),
        ("sortie.contract", format!("{:016x}", network.contract)),
        ("sortie.features", features.to_string()),
        ("sortie.actions", actions.to_string()),
        ("sortie.append_last_action", u8::from(network.append_last_action).to_string()),
    ];
    let doc = "Utilities of one agent. Masked entities have no influence; an agent that sees nothing, \
               not even itself, gets the utilities of its biases.";
    Ok(graph.into_model("agent", doc, &metadata))
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

/// Attention of the agent's own query over all entities.
fn attention(
    graph: &mut Graph,
    network: &AgentNetwork<'_>,
    embedding: &str,
) -> Result<String, ExportError> {
    let (width, heads) = (network.width, network.heads);
    let packed = [width, 3 * width];
    let weights = inputs_first("attention.in.weight", &network.attention_in, packed)?;
    let [query, key, value] =
        [0, 1, 2].map(|part| columns(&weights, 3 * width, part * width, width));
    let own = graph.node("attention.own", "Gather", &[embedding, "self_index"], &[axis(0)]);

    let split = graph.integers("attention.split", &[0, heads as i64, (width / heads) as i64]);
    let mut heads_of = |name: &str, input: &str, weights: &[f32], order: &[i64]| {
        let weight = format!("{name}.weight");
        graph.floats(&weight, &[width, width], weights);
        let product = graph.node(name, "MatMul", &[input, &weight], &[]);
        let heads = graph.node(&format!("{name}.heads"), "Reshape", &[&product, split], &[]);
        graph.node(
            &format!("{name}.ordered"),
            "Transpose",
            &[&heads],
            &[Attribute::Ints("perm", order)],
        )
    };
    let query = heads_of("attention.query", &own, &query, &[1, 0, 2]);
    let key = heads_of("attention.key", embedding, &key, &[1, 2, 0]);
    let value = heads_of("attention.value", embedding, &value, &[1, 0, 2]);

    let scale = 1.0 / ((width / heads) as f32).sqrt();
    let scale = graph.floats("attention.scale", &[], &[scale]);
    let blocked = graph.floats("attention.blocked", &[], &[BLOCKED]);
    let nothing = graph.floats("attention.nothing", &[], &[0.0]);
    let scores = graph.node("attention.scores", "MatMul", &[&query, &key], &[]);
    let logits = graph.node("attention.logits", "Mul", &[&scores, scale], &[]);
    let masked = graph.node("attention.masked", "Where", &["visible", &logits, blocked], &[]);
    let shares = graph.node("attention.softmax", "Softmax", &[&masked], &[axis(-1)]);
    let shares = graph.node("attention.weights", "Where", &["visible", &shares, nothing], &[]);

    let mixed = graph.node("attention.mixed", "MatMul", &[&shares, &value], &[]);
    let order = Attribute::Ints("perm", &[1, 0, 2]);
    let mixed = graph.node("attention.mixed.ordered", "Transpose", &[&mixed], &[order]);
    let join = graph.integers("attention.join", &[1, width as i64]);
    let joined = graph.node("attention.joined", "Reshape", &[&mixed, join], &[]);
    layer(graph, "attention.out", &joined, &network.attention_out, [width, width])
}

/// `input W + b`.
fn layer(
    graph: &mut Graph,
    name: &'static str,
    input: &str,
    layer: &Layer<'_>,
    [inputs, outputs]: [usize; 2],
) -> Result<String, ExportError> {
    check(name, layer.bias, outputs)?;
    let (weight, bias) = (format!("{name}.weight"), format!("{name}.bias"));
    let values = inputs_first(name, &layer.weight, [inputs, outputs])?;
    graph.floats(&weight, &[inputs, outputs], &values);
    graph.floats(&bias, &[outputs], layer.bias);
    let product = graph.node(&format!("{name}.product"), "MatMul", &[input, &weight], &[]);
    Ok(graph.node(name, "Add", &[&product, &bias], &[]))
}

fn axis(axis: i64) -> Attribute<'static> {
    Attribute::Int("axis", axis)
}

/// The matrix as `[inputs, outputs]`, so that no graph needs to transpose it.
fn inputs_first<'a>(
    tensor: &'static str,
    matrix: &Matrix<'a>,
    [inputs, outputs]: [usize; 2],
) -> Result<Cow<'a, [f32]>, ExportError> {
    check(tensor, matrix.values, inputs * outputs)?;
    if matrix.layout == Layout::InputsFirst {
        return Ok(Cow::Borrowed(matrix.values));
    }
    let column = |input: usize| matrix.values.iter().skip(input).step_by(inputs);
    Ok((0..inputs).flat_map(column).copied().collect())
}

/// Some columns of a matrix of rows of `stride` values.
fn columns(values: &[f32], stride: usize, start: usize, count: usize) -> Vec<f32> {
    values.chunks(stride).flat_map(|row| row.iter().skip(start).take(count)).copied().collect()
}

fn check(tensor: &'static str, values: &[f32], want: usize) -> Result<(), ExportError> {
    let got = values.len();
    if got != want {
        return Err(ExportError::WrongLength { tensor, want, got });
    }
    if values.iter().any(|value| !value.is_finite()) {
        return Err(ExportError::NonFinite { tensor });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use safetensors::SafeTensors;

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
            actions: 12,
            append_last_action: true,
            width: 128,
            heads: 4,
            base: 64,
            fc1,
            attention_in: outputs_first(&attention_in),
            attention_out,
            fc2,
            head,
            contract: 0,
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
            network.head.weight = Matrix { values, layout: Layout::InputsFirst };
        });
        assert!(written.unwrap() == want);
    }

    #[test]
    fn networks_that_do_not_fit_are_refused() {
        let error = export(|network| network.base = 32).unwrap_err();
        assert_eq!(error.to_string(), "`fc2` has 64 values, the network's shape asks for 32");
        assert_eq!(export(|n| n.heads = 3), Err(ExportError::Heads { heads: 3, width: 128 }));
        assert_eq!(export(|n| n.heads = 0), Err(ExportError::Heads { heads: 0, width: 128 }));
        let error = export(|network| network.fc1.bias = &[f32::NAN; 128]).unwrap_err();
        assert_eq!(error, ExportError::NonFinite { tensor: "fc1" });
    }
}
