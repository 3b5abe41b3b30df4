//! `allocator_encoder.onnx` and `allocator_decoder.onnx`: what a plan keeps of subtasks, and one agent's decision.

use sortie_learn::export::ExportError;
use sortie_learn::export::attention::{Layout, Matrix, axis, check, inputs_first};
use sortie_learn::export::onnx::{Attribute, Dim, Element, Graph, metadata};
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::layers::split_attention::HEADS;
use sortie_nn::tape::Linear;

use super::network::{BOUND, Layer, Network, TABLES};

/// Stands for minus infinity among logits.
const BLOCKED: f32 = -1.0e30;

/// The largest team, and most subtasks.
#[derive(Clone, Copy, Debug)]
struct Most {
    agents: usize,
    tasks: usize,
}

/// Writes the network with these weights as encoder and decoder, for so many agents and subtasks and the contract of this hash.
///
/// # Errors
/// A weight is not finite.
pub(super) fn graphs(
    network: &Network,
    weights: &[f32],
    [agents, tasks]: [usize; 2],
    contract: u64,
) -> Result<[Vec<u8>; 2], ExportError> {
    let most = Most { agents, tasks };
    let writer = || Writer { graph: Graph::default(), weights, width: network.width };
    Ok([writer().encoder(network, most, contract)?, writer().decoder(network, most, contract)?])
}

/// A graph that is written.
struct Writer<'a> {
    graph: Graph,
    weights: &'a [f32],
    width: usize,
}

impl Writer<'_> {
    fn encoder(
        mut self,
        network: &Network,
        most: Most,
        contract: u64,
    ) -> Result<Vec<u8>, ExportError> {
        let (tasks, fixed) = (Dim::Fixed(most.tasks), network.columns[0]);
        let columns = TABLES * self.width;
        let doc = "Of every subtask what stays as it is in an episode.";
        self.graph.input("subtasks", Element::Float, &[tasks, Dim::Fixed(fixed)], doc);
        self.graph.input("present", Element::Bool, &[tasks], "True where there is such a subtask.");
        let doc = "What decisions look up about each.";
        self.graph.output("tables", Element::Float, &[tasks, Dim::Fixed(columns)], doc);
        let mut x = self.dense("embedding", "subtasks", network.embedding)?;
        for (number, (keys_values, layer)) in network.layers.iter().enumerate() {
            let name = format!("encoder.{number}");
            let normal = self.normalised(&format!("{name}.normal"), &x);
            let keys_values = self.dense(&format!("{name}.keys_values"), &normal, *keys_values)?;
            x = self.layer(&name, layer, [&x, &keys_values, "present"])?;
        }
        let normal = self.normalised("normal", &x);
        self.dense("tables", &normal, network.tables)?;
        let doc = "Encodes all subtasks, once an episode.";
        let sizes = [("sortie.features", fixed), ("sortie.tasks", most.tasks)];
        let metadata = metadata("pointing-encoder", contract, sizes);
        Ok(self.graph.into_model("allocator_encoder", doc, &metadata))
    }

    fn decoder(
        mut self,
        network: &Network,
        most: Most,
        contract: u64,
    ) -> Result<Vec<u8>, ExportError> {
        let (width, columns) = (self.width, network.columns[1]);
        let others = Dim::Fixed((most.agents - 1).max(1));
        let (rows, tasks) =
            (Dim::Fixed(most.tasks + (most.agents - 1).max(1)), Dim::Fixed(most.tasks));
        let (one, context) = (Dim::Fixed(1), Dim::Fixed(network.context.shape.input));
        let mut input = |name, element, shape: &[Dim<'_>], doc| {
            self.graph.input(name, element, shape, doc);
        };
        input("context", Element::Float, &[one, context], "The agent, and all others in short.");
        let doc =
            "The last part of the table of what the agent had last; zeros where that is nothing.";
        input("own", Element::Float, &[one, Dim::Fixed(width)], doc);
        let doc = "Rows of the other agents, and whether they have chosen already.";
        input("others", Element::Float, &[others, Dim::Fixed(columns + 1)], doc);
        let doc =
            "The second part of the tables of what each had last; zeros where that is nothing.";
        input("given", Element::Float, &[others, Dim::Fixed(2 * width)], doc);
        let doc = "True for subtasks that are left, then for the other agents.";
        input("seen", Element::Bool, &[rows], doc);
        let doc = "What the encoder made of subtasks.";
        input("tables", Element::Float, &[tasks, Dim::Fixed(TABLES * width)], doc);
        let doc = "A score for each subtask, whether it can be had or not.";
        self.graph.output("scores", Element::Float, &[tasks], doc);

        let agents = self.dense("agents", "others", network.agents)?;
        let agents = self.graph.node("agents.placed", "Add", &[&agents, "given"], &[]);
        let left = self.columns("left", "tables", 0..2 * width);
        let keys_values = self.graph.node("keys_values", "Concat", &[&left, &agents], &[axis(0)]);
        let x = self.dense("context.embedding", "context", network.context)?;
        let x = self.graph.node("context.placed", "Add", &[&x, "own"], &[]);
        let x = self.layer("decoder", &network.decoder, [&x, &keys_values, "seen"])?;
        let normal = self.normalised("normal", &x);
        let query = self.dense("pointer", &normal, network.pointer)?;
        let keys = self.columns("keys", "tables", 4 * width..5 * width);
        let turned = Attribute::Ints("perm", &[1, 0]);
        let keys = self.graph.node("keys.turned", "Transpose", &[&keys], &[turned]);
        let scores = self.graph.node("scores.products", "MatMul", &[&query, &keys], &[]);
        let scores = self.scaled("scores.scaled", &scores, 1.0 / (width as f32).sqrt());
        let scores = self.graph.node("scores.bounded", "Tanh", &[&scores], &[]);
        let scores = self.scaled("scores.wide", &scores, BOUND);
        self.graph.integers("scores.shape", &[most.tasks as i64]);
        self.graph.node("scores", "Reshape", &[&scores, "scores.shape"], &[]);
        let doc = "Scores all subtasks for one agent.";
        let sizes = [("sortie.features", columns), ("sortie.tasks", most.tasks)];
        let metadata = metadata("pointing-decoder", contract, sizes);
        Ok(self.graph.into_model("allocator_decoder", doc, &metadata))
    }

    /// `x W + b`, without the offsets where there are none.
    fn dense(&mut self, name: &str, x: &str, linear: Linear) -> Result<String, ExportError> {
        let (inputs, outputs) = (linear.shape.input, linear.shape.output);
        let values = &self.weights[linear.weight_range()];
        let matrix = Matrix { values, layout: Layout::OutputsFirst };
        let values = inputs_first("allocator", &matrix, [inputs, outputs])?;
        let weight = format!("{name}.weight");
        self.graph.floats(&weight, &[inputs, outputs], &values);
        let Some(bias) = linear.bias_range() else {
            return Ok(self.graph.node(name, "MatMul", &[x, &weight], &[]));
        };
        let (offsets, product) = (format!("{name}.bias"), format!("{name}.product"));
        check("allocator", &self.weights[bias.clone()], outputs)?;
        self.graph.floats(&offsets, &[outputs], &self.weights[bias]);
        self.graph.node(&product, "MatMul", &[x, &weight], &[]);
        Ok(self.graph.node(name, "Add", &[&product, &offsets], &[]))
    }

    /// What [`Layer`] makes of rows, with the keys and values of what they look at, as far as that is seen.
    fn layer(
        &mut self,
        name: &str,
        layer: &Layer,
        [x, keys_values, seen]: [&str; 3],
    ) -> Result<String, ExportError> {
        let part = |part: &str| format!("{name}.{part}");
        let normal = self.normalised(&part("asking"), x);
        let query = self.dense(&part("query"), &normal, layer.query)?;
        let looked = self.attention(&part("look"), [&query, keys_values, seen]);
        let looked = self.dense(&part("attended"), &looked, layer.attended)?;
        let x = self.graph.node(&part("looked"), "Add", &[x, &looked], &[]);
        let normal = self.normalised(&part("looked.normal"), &x);
        let hidden = self.dense(&part("hidden"), &normal, layer.hidden)?;
        let hidden = self.graph.node(&part("hidden.relu"), "Relu", &[&hidden], &[]);
        let out = self.dense(&part("out"), &hidden, layer.out)?;
        Ok(self.graph.node(&part("sum"), "Add", &[&x, &out], &[]))
    }

    /// Rows so scaled that the mean of their squares is 1.
    fn normalised(&mut self, name: &str, x: &str) -> String {
        let part = |part: &str| format!("{name}.{part}");
        let epsilon = part("epsilon");
        self.graph.floats(&epsilon, &[], &[EPSILON]);
        let squares = self.graph.node(&part("squares"), "Mul", &[x, x], &[]);
        let along = [Attribute::Ints("axes", &[-1]), Attribute::Int("keepdims", 1)];
        let mean = self.graph.node(&part("mean"), "ReduceMean", &[&squares], &along);
        let mean = self.graph.node(&part("least"), "Add", &[&mean, &epsilon], &[]);
        let length = self.graph.node(&part("length"), "Sqrt", &[&mean], &[]);
        self.graph.node(name, "Div", &[x, &length], &[])
    }

    /// Attention of every query to the rows that are seen; each of these holds its key, then its value.
    fn attention(&mut self, name: &str, [query, keys_values, seen]: [&str; 3]) -> String {
        let (width, heads) = (self.width, HEADS as i64);
        let part = |part: &str| format!("{name}.{part}");
        let keys = self.columns(&part("keys"), keys_values, 0..width);
        let values = self.columns(&part("values"), keys_values, width..2 * width);
        let (split, join) = (part("split"), part("join"));
        self.graph.integers(&split, &[0, heads, width as i64 / heads]);
        self.graph.integers(&join, &[0, width as i64]);
        let mut by_heads = |of: &str, order: &[i64]| {
            let apart =
                self.graph.node(&format!("{name}.{of}.apart"), "Reshape", &[of, &split], &[]);
            let order = Attribute::Ints("perm", order);
            self.graph.node(&format!("{name}.{of}.turned"), "Transpose", &[&apart], &[order])
        };
        let query = by_heads(query, &[1, 0, 2]);
        let keys = by_heads(&keys, &[1, 2, 0]);
        let values = by_heads(&values, &[1, 0, 2]);
        let scores = self.graph.node(&part("scores"), "MatMul", &[&query, &keys], &[]);
        let scale = ((width / HEADS) as f32).sqrt().recip();
        let scores = self.scaled(&part("logits"), &scores, scale);
        let blocked = part("blocked");
        self.graph.floats(&blocked, &[], &[BLOCKED]);
        let masked = self.graph.node(&part("masked"), "Where", &[seen, &scores, &blocked], &[]);
        let shares = self.graph.node(&part("shares"), "Softmax", &[&masked], &[axis(-1)]);
        let mixed = self.graph.node(&part("mixed"), "MatMul", &[&shares, &values], &[]);
        let order = Attribute::Ints("perm", &[1, 0, 2]);
        let mixed = self.graph.node(&part("ordered"), "Transpose", &[&mixed], &[order]);
        self.graph.node(name, "Reshape", &[&mixed, &join], &[])
    }

    fn columns(&mut self, name: &str, of: &str, range: std::ops::Range<usize>) -> String {
        let part = |part: &str| format!("{name}.{part}");
        let [start, end, along] = ["start", "end", "along"].map(part);
        self.graph.integers(&start, &[range.start as i64]);
        self.graph.integers(&end, &[range.end as i64]);
        self.graph.integers(&along, &[1]);
        self.graph.node(name, "Slice", &[of, &start, &end, &along], &[])
    }

    fn scaled(&mut self, name: &str, x: &str, by: f32) -> String {
        let factor = format!("{name}.factor");
        self.graph.floats(&factor, &[], &[by]);
        self.graph.node(name, "Mul", &[x, &factor], &[])
    }
}
