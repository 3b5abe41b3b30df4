//! `allocator_encoder.onnx` and `allocator_decoder.onnx`: what a plan keeps of subtasks, and one agent's decision.

use std::ops::Range;

use sortie_learn::export::ExportError;
use sortie_learn::export::attention::{BLOCKED, Layer, Layout, axis, inputs_first, layer};
use sortie_learn::export::onnx::{Attribute, Dim, Element, Graph, metadata};
use sortie_nn::layers::normalise::EPSILON;
use sortie_nn::layers::split_attention::HEADS;
use sortie_nn::tape::Linear;

use super::network::{self, BOUND, Network};

/// An end behind all others.
const END: usize = i32::MAX as usize;
/// What decisions look at all the time, by names.
const LOOKED_AT: [&str; 3] = ["keys", "values", "points"];

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

/// Shapes of [`LOOKED_AT`]: `[heads, width / heads, T]`, `[heads, T, width / heads]`, `[width, T]`.
fn looked_at(most: Most, width: usize) -> [Vec<Dim<'static>>; 3] {
    let (tasks, heads, share) =
        (Dim::Fixed(most.tasks), Dim::Fixed(HEADS), Dim::Fixed(width / HEADS));
    [vec![heads, share, tasks], vec![heads, tasks, share], vec![Dim::Fixed(width), tasks]]
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
        let (tasks, fixed, width) = (Dim::Fixed(most.tasks), network.columns[0], self.width);
        let doc = "Of every subtask what stays as it is in an episode.";
        self.graph.input("subtasks", Element::Float, &[tasks, Dim::Fixed(fixed)], doc);
        self.graph.input("present", Element::Bool, &[tasks], "True where there is such a subtask.");
        let doc = "What is added to keys and values of who had it last, and to who decides then.";
        self.graph.output("tables", Element::Float, &[tasks, Dim::Fixed(3 * width)], doc);
        let [keys, values, points] = looked_at(most, width);
        let doc = "Keys of those that are left, by heads.";
        self.graph.output("keys", Element::Float, &keys, doc);
        self.graph.output("values", Element::Float, &values, "Their values, by heads.");
        self.graph.output("points", Element::Float, &points, "Keys to point at.");
        let mut x = self.dense("embedding", "subtasks", network.embedding)?;
        for (number, (keys_values, layer)) in network.layers.iter().enumerate() {
            let name = format!("encoder.{number}");
            let normal = self.normalised(&format!("{name}.normal"), &x);
            let keys_values = self.dense(&format!("{name}.keys_values"), &normal, *keys_values)?;
            x = self.layer(&name, layer, &x, |writer, query, name| {
                writer.attention(name, [query, &keys_values, "present"])
            })?;
        }
        let normal = self.normalised("normal", &x);
        let all = self.dense("all", &normal, network.tables)?;
        // As decoders take them: whatever is turned or taken apart here is not in each of many decisions.
        let keys = self.columns("left.keys", &all, 0..width);
        self.by_heads("keys", &keys, [1, 2, 0]);
        let values = self.columns("left.values", &all, width..2 * width);
        self.by_heads("values", &values, [1, 0, 2]);
        let placed = self.columns("placed", &all, 2 * width..4 * width);
        let own = self.columns("own", &all, 5 * width..6 * width);
        self.graph.node("tables", "Concat", &[&placed, &own], &[axis(1)]);
        let points = self.columns("left.points", &all, 4 * width..5 * width);
        let turned = Attribute::Ints("perm", &[1, 0]);
        self.graph.node("points", "Transpose", &[&points], &[turned]);
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
        let rows = Dim::Fixed(most.tasks + (most.agents - 1).max(1));
        let tasks = Dim::Fixed(most.tasks);
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
            "The first part of the tables of what each had last; zeros where that is nothing.";
        input("given", Element::Float, &[others, Dim::Fixed(2 * width)], doc);
        let doc = "True for subtasks that are left, then for the other agents.";
        input("seen", Element::Bool, &[rows], doc);
        for (name, shape) in LOOKED_AT.into_iter().zip(looked_at(most, width)) {
            input(name, Element::Float, &shape, "As the encoder made it of subtasks.");
        }
        let doc = "A score for each subtask, whether it can be had or not.";
        self.graph.output("scores", Element::Float, &[tasks], doc);

        let agents = self.dense("agents", "others", network.agents)?;
        let agents = self.graph.node("agents.placed", "Add", &[&agents, "given"], &[]);
        let x = self.dense("context.embedding", "context", network.context)?;
        let x = self.graph.node("context.placed", "Add", &[&x, "own"], &[]);
        let x = self.layer("decoder", &network.decoder, &x, |writer, query, name| {
            writer.attention_to_both(name, query, &agents, most.tasks)
        })?;
        let normal = self.normalised("normal", &x);
        let query = self.dense("pointer", &normal, network.pointer)?;
        let scores = self.graph.node("scores.products", "MatMul", &[&query, "points"], &[]);
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
        let sizes = [linear.shape.input, linear.shape.output];
        let own = Layer::of(linear, self.weights, Layout::OutputsFirst);
        if linear.bias.is_some() {
            return layer(&mut self.graph, name, x, &own, sizes);
        }
        let weight = format!("{name}.weight");
        self.graph.floats(&weight, &sizes, &inputs_first(name, &own.weight, sizes)?);
        Ok(self.graph.node(name, "MatMul", &[x, &weight], &[]))
    }

    /// What a [layer](network::Layer) makes of rows, by the attention of their queries.
    fn layer(
        &mut self,
        name: &str,
        layer: &network::Layer,
        x: &str,
        attention: impl FnOnce(&mut Self, &str, &str) -> String,
    ) -> Result<String, ExportError> {
        let part = |part: &str| format!("{name}.{part}");
        let normal = self.normalised(&part("asking"), x);
        let query = self.dense(&part("query"), &normal, layer.query)?;
        let looked = attention(self, &query, &part("look"));
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
        let part = |part: &str| format!("{name}.{part}");
        let [keys, values] = self.keys_and_values(name, keys_values);
        let query = self.by_heads(&part("query"), query, [1, 0, 2]);
        let scores = self.graph.node(&part("scores"), "MatMul", &[&query, &keys], &[]);
        let shares = self.shares(name, &scores, seen);
        let mixed = self.graph.node(&part("mixed"), "MatMul", &[&shares, &values], &[]);
        self.joined(name, &mixed)
    }

    /// Attention of one query to the subtasks that are left, by the keys and values that the encoder made, and to other agents.
    fn attention_to_both(&mut self, name: &str, query: &str, agents: &str, tasks: usize) -> String {
        let part = |part: &str| format!("{name}.{part}");
        let [keys, values] = self.keys_and_values(name, agents);
        let query = self.by_heads(&part("query"), query, [1, 0, 2]);
        let of_tasks = self.graph.node(&part("scores.tasks"), "MatMul", &[&query, "keys"], &[]);
        let of_agents = self.graph.node(&part("scores.agents"), "MatMul", &[&query, &keys], &[]);
        let both = [&*of_tasks, &of_agents];
        let scores = self.graph.node(&part("scores"), "Concat", &both, &[axis(2)]);
        let shares = self.shares(name, &scores, "seen");
        let of_tasks = self.sliced(&part("shares.tasks"), &shares, 2, 0..tasks);
        let of_agents = self.sliced(&part("shares.agents"), &shares, 2, tasks..END);
        let tasks = self.graph.node(&part("mixed.tasks"), "MatMul", &[&of_tasks, "values"], &[]);
        let agents = self.graph.node(&part("mixed.agents"), "MatMul", &[&of_agents, &values], &[]);
        let mixed = self.graph.node(&part("mixed"), "Add", &[&tasks, &agents], &[]);
        self.joined(name, &mixed)
    }

    /// Keys `[heads, width / heads, rows]` and values `[heads, rows, width / heads]` of rows that hold one behind the other.
    fn keys_and_values(&mut self, name: &str, rows: &str) -> [String; 2] {
        let (width, part) = (self.width, |part: &str| format!("{name}.{part}"));
        let keys = self.columns(&part("keys.columns"), rows, 0..width);
        let values = self.columns(&part("values.columns"), rows, width..2 * width);
        [
            self.by_heads(&part("keys"), &keys, [1, 2, 0]),
            self.by_heads(&part("values"), &values, [1, 0, 2]),
        ]
    }

    /// Rows `[rows, width]` as `[rows, heads, width / heads]`, turned.
    fn by_heads(&mut self, name: &str, rows: &str, order: [i64; 3]) -> String {
        let (split, heads) = (format!("{name}.split"), HEADS as i64);
        self.graph.integers(&split, &[0, heads, self.width as i64 / heads]);
        let apart = self.graph.node(&format!("{name}.apart"), "Reshape", &[rows, &split], &[]);
        self.graph.node(name, "Transpose", &[&apart], &[Attribute::Ints("perm", &order)])
    }

    /// What by heads was mixed, as rows.
    fn joined(&mut self, name: &str, mixed: &str) -> String {
        let (join, ordered) = (format!("{name}.joint"), format!("{name}.ordered"));
        self.graph.integers(&join, &[0, self.width as i64]);
        let order = Attribute::Ints("perm", &[1, 0, 2]);
        let mixed = self.graph.node(&ordered, "Transpose", &[mixed], &[order]);
        self.graph.node(name, "Reshape", &[&mixed, &join], &[])
    }

    /// The softmax of the scores of what is seen.
    fn shares(&mut self, name: &str, scores: &str, seen: &str) -> String {
        let part = |part: &str| format!("{name}.{part}");
        let scale = ((self.width / HEADS) as f32).sqrt().recip();
        let scores = self.scaled(&part("logits"), scores, scale);
        let blocked = part("blocked");
        self.graph.floats(&blocked, &[], &[BLOCKED]);
        let masked = self.graph.node(&part("masked"), "Where", &[seen, &scores, &blocked], &[]);
        self.graph.node(&part("shares"), "Softmax", &[&masked], &[axis(-1)])
    }

    fn columns(&mut self, name: &str, of: &str, range: Range<usize>) -> String {
        self.sliced(name, of, 1, range)
    }

    fn sliced(&mut self, name: &str, of: &str, axis: i64, range: Range<usize>) -> String {
        let part = |part: &str| format!("{name}.{part}");
        let [start, end, along] = ["start", "end", "along"].map(part);
        self.graph.integers(&start, &[range.start as i64]);
        self.graph.integers(&end, &[range.end as i64]);
        self.graph.integers(&along, &[axis]);
        self.graph.node(name, "Slice", &[of, &start, &end, &along], &[])
    }

    fn scaled(&mut self, name: &str, x: &str, by: f32) -> String {
        let factor = format!("{name}.factor");
        self.graph.floats(&factor, &[], &[by]);
        self.graph.node(name, "Mul", &[x, &factor], &[])
    }
}
