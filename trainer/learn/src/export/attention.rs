//! The layers that agents and allocators share: embed every entity, attend with one row's query, two layers.

use std::borrow::Cow;

use sortie_nn::tape::Linear;

use super::onnx::{Attribute, Graph};

/// Stands for minus infinity among logits; the softmax of a row that holds nothing else stays finite.
pub const BLOCKED: f32 = -1.0e30;

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

impl<'a> Layer<'a> {
    /// A layer whose weights are stored as PyTorch does.
    pub fn outputs_first(values: &'a [f32], bias: &'a [f32]) -> Self {
        Self { weight: Matrix { values, layout: Layout::OutputsFirst }, bias }
    }

    /// A layer of these parameters, whose weights are stored so; without offsets the bias is empty.
    pub fn of(layer: Linear, parameters: &'a [f32], layout: Layout) -> Self {
        let values = &parameters[layer.weight_range()];
        let bias = layer.bias_range().map_or(&[][..], |range| &parameters[range]);
        Self { weight: Matrix { values, layout }, bias }
    }
}

/// A feed-forward attention network (dissertation section 7.3): embed, attend, two layers; of which the first may be
/// missing, and past whose attention the own row's embedding may skip.
#[derive(Clone, Copy, Debug)]
pub struct AttentionNetwork<'a> {
    /// Input columns D of an entity.
    pub inputs: usize,
    /// Width E of the embedding and the attention.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
    /// Width R of the layer before the head; E where there is none.
    pub base: usize,
    /// Outputs U.
    pub outputs: usize,
    /// D to E.
    pub fc1: Layer<'a>,
    /// E to 3 E, without bias: query, key, value.
    pub attention_in: Matrix<'a>,
    /// E to E.
    pub attention_out: Layer<'a>,
    /// E to E, without bias: what the own row's embedding adds to the attention's output.
    pub skip: Option<Matrix<'a>>,
    /// E to R.
    pub fc2: Option<Layer<'a>>,
    /// R to U; where the network points, to the actions that aim at nobody.
    pub head: Layer<'a>,
    /// What scores the actions that are aimed at entities.
    pub pointing: Option<PointingHead<'a>>,
}

/// A head that points: the utility of an action that is aimed at an entity is the product of the agent's vector with that
/// entity's embedding, and with what is known of the pair.
#[derive(Clone, Copy, Debug)]
pub struct PointingHead<'a> {
    /// The entity that the first of these actions aims at; each of them aims at the next one.
    pub first_entity: usize,
    /// How many actions aim at an entity; they are the last ones.
    pub count: usize,
    /// R to E: the agent's vector.
    pub query: Layer<'a>,
    /// What is known of pairs, if anything.
    pub pairs: Option<PairHead<'a>>,
    /// What both products are multiplied by.
    pub scale: f32,
}

/// What the features of a pair count for.
#[derive(Clone, Copy, Debug)]
pub struct PairHead<'a> {
    /// The input column of the agent's own row where they begin, target by target.
    pub first: usize,
    /// Features F of a pair.
    pub features: usize,
    /// R to F: what the agent makes of each.
    pub weights: Layer<'a>,
}

/// Why a network cannot be exported.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A tensor does not have the size that the network's shape asks for.
    #[error("`{tensor}` has {got} values, the network's shape asks for {want}")]
    WrongLength {
        /// The tensor.
        tensor: String,
        /// Values asked for.
        want: usize,
        /// Values given.
        got: usize,
    },
    /// A tensor holds a value that is not a finite number: training diverged.
    #[error("`{tensor}` holds a value that is not finite: the training diverged")]
    NonFinite {
        /// The tensor.
        tensor: String,
    },
    /// The network takes other columns than the graph's inputs have.
    #[error("the network takes {got} columns, the graph has {want}")]
    Columns {
        /// Columns of the graph's inputs.
        want: usize,
        /// Columns that the network takes.
        got: usize,
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

/// What the layers read, by the names of values in the graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs<'a> {
    /// Rows f32 `[N, D]`.
    pub(super) rows: &'a str,
    /// The row that forms the query, i64 `[1]`.
    pub(super) own: &'a str,
    /// What it attends to, bool `[N]`.
    pub(super) visible: &'a str,
}

/// Adds the network's nodes; the last one gives `output` `[U]`.
pub(super) fn add_network(
    graph: &mut Graph,
    network: &AttentionNetwork<'_>,
    inputs: Inputs<'_>,
    output: &str,
) -> Result<(), ExportError> {
    let (embedding, base) = add_base(graph, network, inputs, true)?;
    add_utilities(graph, network, inputs, [&embedding, &base], output)
}

/// Adds the nodes in front of the head and returns the names of the embedding `[N, E]` and of the last one, `[1, R]`.
pub(super) fn add_base(
    graph: &mut Graph,
    network: &AttentionNetwork<'_>,
    inputs: Inputs<'_>,
    attention_relu: bool,
) -> Result<(String, String), ExportError> {
    let AttentionNetwork { inputs: columns, width, heads, base, .. } = *network;
    if heads == 0 || !width.is_multiple_of(heads) {
        return Err(ExportError::Heads { heads, width });
    }
    let fc1 = layer(graph, "fc1", inputs.rows, &network.fc1, [columns, width])?;
    let embedding = graph.node("fc1.relu", "Relu", &[&fc1], &[]);
    let mut last = attention(graph, network, inputs, &embedding)?;
    if attention_relu {
        last = graph.node("attention.relu", "Relu", &[&last], &[]);
    }
    if let Some(fc2) = &network.fc2 {
        let fc2 = layer(graph, "fc2", &last, fc2, [width, base])?;
        last = graph.node("fc2.relu", "Relu", &[&fc2], &[]);
    }
    Ok((embedding, last))
}

/// Adds the heads, on the embedding `[N, E]` and the base `[1, R]`; they give `output` `[U]`.
///
/// An action whose target is not visible has the utility 0.
pub(super) fn add_utilities(
    graph: &mut Graph,
    network: &AttentionNetwork<'_>,
    inputs: Inputs<'_>,
    [embedding, base]: [&str; 2],
    output: &str,
) -> Result<(), ExportError> {
    let all = match &network.pointing {
        None => layer(graph, "head", base, &network.head, [network.base, network.outputs])?,
        Some(pointing) => add_pointing(graph, network, pointing, inputs, [embedding, base])?,
    };
    let shape_name = format!("{output}.shape");
    let shape = graph.integers(&shape_name, &[network.outputs as i64]);
    graph.node(output, "Reshape", &[&all, shape], &[]);
    Ok(())
}

/// Adds the utilities `[1, U]` of a network that points.
fn add_pointing(
    graph: &mut Graph,
    network: &AttentionNetwork<'_>,
    head: &PointingHead<'_>,
    inputs: Inputs<'_>,
    [embedding, base]: [&str; 2],
) -> Result<String, ExportError> {
    let PointingHead { first_entity, count, query, pairs, scale } = head;
    let targets: Vec<i64> = (*first_entity..first_entity + count).map(|row| row as i64).collect();
    let targets = graph.integers("pointing.targets", &targets);
    let nothing = graph.floats("pointing.nothing", &[], &[0.0]);
    let untargeted = [network.base, network.outputs - count];
    let untargeted = layer(graph, "head", base, &network.head, untargeted)?;
    let sizes = [network.base, network.width];
    let query = layer_with(graph, ("pointing.query", query, *scale), base, sizes, None)?;
    let rows = graph.node("pointing.rows", "Gather", &[embedding, targets], &[axis(0)]);
    let turned = Attribute::Ints("perm", &[1, 0]);
    let rows = graph.node("pointing.columns", "Transpose", &[&rows], &[turned]);
    let mut scores = graph.node("pointing.scores", "MatMul", &[&query, &rows], &[]);
    if let Some(pairs) = pairs {
        let (weights, sizes) = (&pairs.weights, [network.base, pairs.features]);
        let weights = layer_with(graph, ("pairs.weights", weights, *scale), base, sizes, None)?;
        let pairs = add_pairs(graph, [inputs.rows, inputs.own], pairs, *count);
        let known = graph.node("pairs.scores", "MatMul", &[&weights, &pairs], &[]);
        scores = graph.node("pointing.related", "Add", &[&scores, &known], &[]);
    }
    let seen = graph.node("pointing.seen", "Gather", &[inputs.visible, targets], &[axis(0)]);
    let aimed = graph.node("pointing", "Where", &[&seen, &scores, nothing], &[]);
    Ok(graph.node("heads", "Concat", &[&untargeted, &aimed], &[axis(1)]))
}

/// Adds the features of pairs `[F, targets]`, which stand in the own one of the rows.
fn add_pairs(
    graph: &mut Graph,
    [rows, own]: [&str; 2],
    pairs: &PairHead<'_>,
    targets: usize,
) -> String {
    let PairHead { first, features, .. } = *pairs;
    let own = graph.node("pairs.own", "Gather", &[rows, own], &[axis(0)]);
    let mut integers = |name: &str, values: &[usize]| {
        let values: Vec<i64> = values.iter().map(|value| *value as i64).collect();
        graph.integers(name, &values).to_owned()
    };
    let start = integers("pairs.start", &[first]);
    let end = integers("pairs.end", &[first + targets * features]);
    let (axes, size) = (integers("pairs.axis", &[1]), integers("pairs.size", &[targets, features]));
    let own = graph.node("pairs.columns", "Slice", &[&own, &start, &end, &axes], &[]);
    let pairs = graph.node("pairs", "Reshape", &[&own, &size], &[]);
    graph.node("pairs.turned", "Transpose", &[&pairs], &[Attribute::Ints("perm", &[1, 0])])
}

/// Attention of the own row's query over all entities.
fn attention(
    graph: &mut Graph,
    network: &AttentionNetwork<'_>,
    inputs: Inputs<'_>,
    embedding: &str,
) -> Result<String, ExportError> {
    let (width, heads) = (network.width, network.heads);
    let packed = [width, 3 * width];
    let weights = inputs_first("attention.in.weight", &network.attention_in, packed)?;
    let [query, key, value] =
        [0, 1, 2].map(|part| columns(&weights, 3 * width, part * width, width));
    let asking = graph.node("attention.own", "Gather", &[embedding, inputs.own], &[axis(0)]);
    graph.integers("attention.split", &[0, heads as i64, (width / heads) as i64]);
    let mut heads_of = |name: &str, input: &str, weights: &[f32], order: &[i64]| {
        let weight = format!("{name}.weight");
        graph.floats(&weight, &[width, width], weights);
        let product = graph.node(name, "MatMul", &[input, &weight], &[]);
        by_heads(graph, &product, order)
    };
    let query = heads_of("attention.query", &asking, &query, &[1, 0, 2]);
    let key = heads_of("attention.key", embedding, &key, &[1, 2, 0]);
    let value = heads_of("attention.value", embedding, &value, &[1, 0, 2]);
    let joined = mixed(graph, [&query, &key, &value], inputs.visible, [1, width, heads]);
    let skip = match &network.skip {
        Some(skip) => {
            let weights = inputs_first("skip.weight", skip, [width, width])?;
            graph.floats("skip.weight", &[width, width], &weights);
            Some(graph.node("skip", "MatMul", &[&asking, "skip.weight"], &[]))
        }
        None => None,
    };
    let sizes = [width, width];
    let out = ("attention.out", &network.attention_out, 1.0);
    layer_with(graph, out, &joined, sizes, skip.as_deref())
}

/// Rows as `attention.split` cuts them into heads, turned.
pub fn by_heads(graph: &mut Graph, rows: &str, order: &[i64]) -> String {
    let heads = graph.node(&format!("{rows}.heads"), "Reshape", &[rows, "attention.split"], &[]);
    let order = [Attribute::Ints("perm", order)];
    graph.node(&format!("{rows}.ordered"), "Transpose", &[&heads], &order)
}

/// Values `[rows, E]` mixed by how queries and keys go together, all by heads, of what is visible. As many rows as queries,
/// where 0 says how many.
pub fn mixed(
    graph: &mut Graph,
    [query, key, value]: [&str; 3],
    visible: &str,
    [rows, width, heads]: [usize; 3],
) -> String {
    let scale = 1.0 / ((width / heads) as f32).sqrt();
    let scale = graph.floats("attention.scale", &[], &[scale]);
    let blocked = graph.floats("attention.blocked", &[], &[BLOCKED]);
    let nothing = graph.floats("attention.nothing", &[], &[0.0]);
    let scores = graph.node("attention.scores", "MatMul", &[query, key], &[]);
    let logits = graph.node("attention.logits", "Mul", &[&scores, scale], &[]);
    let masked = graph.node("attention.masked", "Where", &[visible, &logits, blocked], &[]);
    let shares = graph.node("attention.softmax", "Softmax", &[&masked], &[axis(-1)]);
    let shares = graph.node("attention.weights", "Where", &[visible, &shares, nothing], &[]);

    let mixed = graph.node("attention.mixed", "MatMul", &[&shares, value], &[]);
    let order = Attribute::Ints("perm", &[1, 0, 2]);
    let mixed = graph.node("attention.mixed.ordered", "Transpose", &[&mixed], &[order]);
    let join = graph.integers("attention.join", &[rows as i64, width as i64]);
    graph.node("attention.joined", "Reshape", &[&mixed, join], &[])
}

/// `input W + b`.
pub fn layer(
    graph: &mut Graph,
    name: &str,
    input: &str,
    layer: &Layer<'_>,
    sizes: [usize; 2],
) -> Result<String, ExportError> {
    layer_with(graph, (name, layer, 1.0), input, sizes, None)
}

/// `input W + added + b`, with weights and offsets that are so many times as large.
fn layer_with(
    graph: &mut Graph,
    (name, layer, factor): (&str, &Layer<'_>, f32),
    input: &str,
    [inputs, outputs]: [usize; 2],
    added: Option<&str>,
) -> Result<String, ExportError> {
    check(name, layer.bias, outputs)?;
    let (weight, bias) = (format!("{name}.weight"), format!("{name}.bias"));
    let values = inputs_first(name, &layer.weight, [inputs, outputs])?;
    let scaled = |values: &[f32]| values.iter().map(|value| factor * value).collect::<Vec<_>>();
    graph.floats(&weight, &[inputs, outputs], &scaled(&values));
    graph.floats(&bias, &[outputs], &scaled(layer.bias));
    let mut sum = graph.node(&format!("{name}.product"), "MatMul", &[input, &weight], &[]);
    if let Some(added) = added {
        sum = graph.node(&format!("{name}.sum"), "Add", &[&sum, added], &[]);
    }
    Ok(graph.node(name, "Add", &[&sum, &bias], &[]))
}

/// The attribute of operators that work along an axis.
pub fn axis(axis: i64) -> Attribute<'static> {
    Attribute::Int("axis", axis)
}

/// The matrix as `[inputs, outputs]`, so that no graph needs to transpose it.
pub fn inputs_first<'a>(
    tensor: &str,
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

/// Checks the size of a tensor, and that all its numbers are finite.
pub fn check(tensor: &str, values: &[f32], want: usize) -> Result<(), ExportError> {
    let (tensor, got) = (tensor.to_owned(), values.len());
    if got != want {
        return Err(ExportError::WrongLength { tensor, want, got });
    }
    if values.iter().any(|value| !value.is_finite()) {
        return Err(ExportError::NonFinite { tensor });
    }
    Ok(())
}
