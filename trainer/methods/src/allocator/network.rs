//! The network: subtasks are encoded once an episode, then each agent in turn points at one of them (the attention model of
//! Kool et al. 2019, with the other agents and what they were given in its sight).

use sortie_core::allocate::pointing::Round;
use sortie_envs::TaskSet;
use sortie_learn::LearnError;
use sortie_learn::configuration::require;
use sortie_nn::layers::VisibleLists;
use sortie_nn::layers::split_attention::HEADS;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::NetworkConfig;

/// Scores lie between this and its negative, so that no choice is ever out of the question (Bello et al. 2017).
pub(super) const BOUND: f32 = 10.0;
/// Columns of what is known of a subtask, by widths.
pub(super) const TABLES: usize = 6;

/// Where the layers stand among the parameters.
#[derive(Clone, Debug)]
pub(super) struct Network {
    pub(super) width: usize,
    /// Columns of a subtask's row and of an agent's.
    pub(super) columns: [usize; 2],
    pub(super) embedding: Linear,
    /// Keys and values of each encoder's layer, and the layer.
    pub(super) layers: Vec<(Linear, Layer)>,
    pub(super) tables: Linear,
    pub(super) context: Linear,
    pub(super) agents: Linear,
    pub(super) decoder: Layer,
    pub(super) pointer: Linear,
}

/// Attention and a layer behind it, each added to what comes in.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub(super) query: Linear,
    pub(super) attended: Linear,
    pub(super) hidden: Linear,
    pub(super) out: Linear,
}

impl Layer {
    fn new(parameters: &mut Parameters, name: &str, width: usize, random: &mut Generator) -> Self {
        let mut linear = |part: &str, input, output| {
            parameters.linear(&format!("{name}.{part}"), input, output, random)
        };
        Self {
            query: linear("query", width, width),
            attended: linear("attended", width, width),
            hidden: linear("hidden", width, 2 * width),
            out: linear("out", 2 * width, width),
        }
    }

    fn pass(&self, pass: &mut Pass<'_>, x: Var, keys_values: Var, seen: &VisibleLists) -> Var {
        let normal = pass.normalise_rows(x);
        let query = pass.linear(normal, self.query);
        let looked = pass.attention(query, keys_values, seen, HEADS);
        let looked = pass.linear(looked, self.attended);
        let x = pass.add(x, looked);
        let normal = pass.normalise_rows(x);
        let hidden = pass.linear_rectified(normal, self.hidden);
        let out = pass.linear(hidden, self.out);
        pass.add(x, out)
    }
}

/// A layer over features, which are shares of 1 and mostly zeros: drawn three times as wide as others, it comes to routes that
/// are 1 % shorter after as many episodes.
fn first_layer(
    parameters: &mut Parameters,
    name: &str,
    [input, output]: [usize; 2],
    random: &mut Generator,
) -> Linear {
    let layer = parameters.linear(name, input, output, random);
    parameters.values[layer.weight_range()].iter_mut().for_each(|weight| *weight *= 3.0);
    layer
}

fn encoder_layer(
    parameters: &mut Parameters,
    number: usize,
    width: usize,
    random: &mut Generator,
) -> (Linear, Layer) {
    let name = format!("encoder.{number}");
    let keys_values = parameters.linear(&format!("{name}.keys_values"), width, 2 * width, random);
    (keys_values, Layer::new(parameters, &name, width, random))
}

/// Decisions about one agent each, all on the same subtasks: what was seen, and what was chosen.
#[derive(Clone, Debug, Default)]
pub(super) struct Decisions {
    /// `[D, C]`: [descriptions](Round::describe) of the agents.
    pub(super) contexts: Vec<f32>,
    /// The places of what the agents had last; as many as there are subtasks where that is nothing.
    pub(super) own: Vec<u32>,
    /// [Descriptions](Round::describe_other) of the other agents, of all decisions.
    pub(super) agents: Vec<f32>,
    /// The places of what they had last.
    pub(super) given: Vec<u32>,
    /// Subtasks that are left, and, counted behind all subtasks, the other agents.
    pub(super) seen: VisibleLists,
    /// What could be chosen, as bits by places of subtasks.
    pub(super) offered: Vec<TaskSet>,
    /// The places of those that were.
    pub(super) chosen: Vec<usize>,
    /// Whose episodes they belong to.
    pub(super) episodes: Vec<usize>,
}

impl Decisions {
    pub(super) fn clear(&mut self) {
        self.seen.clear();
        self.contexts.clear();
        self.own.clear();
        self.agents.clear();
        self.given.clear();
        self.offered.clear();
        self.chosen.clear();
        self.episodes.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.offered.len()
    }

    /// Adds others on so many subtasks.
    pub(super) fn append(&mut self, other: &Self, subtasks: usize) {
        let agents = self.given.len();
        for decision in 0..other.len() {
            let shifted = |row| if row < subtasks { row } else { row + agents };
            other.seen.list(decision).for_each(|row| self.seen.push(shifted(row)));
            self.seen.end_list();
        }
        self.contexts.extend(&other.contexts);
        self.own.extend(&other.own);
        self.agents.extend(&other.agents);
        self.given.extend(&other.given);
        self.offered.extend(&other.offered);
        self.chosen.extend(&other.chosen);
        self.episodes.extend(&other.episodes);
    }
}

impl Network {
    /// Draws the first weights of a network for rows of subtasks and of agents with so many columns.
    pub(super) fn new(
        config: &NetworkConfig,
        columns: [usize; 2],
        random: &mut Generator,
    ) -> Result<(Self, Parameters), LearnError> {
        let NetworkConfig { width, layers } = *config;
        require(width.is_multiple_of(HEADS), "`network.width` must be a multiple of 4")?;
        let (mut parameters, [subtask, agent]) = (Parameters::default(), columns);
        let p = &mut parameters;
        let network = Self {
            width,
            columns,
            embedding: first_layer(p, "embedding", [subtask, width], random),
            layers: (0..layers).map(|number| encoder_layer(p, number, width, random)).collect(),
            tables: p.linear("tables", width, TABLES * width, random),
            context: first_layer(p, "context", [Round::context(agent, subtask), width], random),
            agents: first_layer(p, "agents", [agent + 1, 2 * width], random),
            decoder: Layer::new(p, "decoder", width, random),
            pointer: p.projection("pointer", width, width, random),
        };
        Ok((network, parameters))
    }

    /// `[subtasks, 6 width]`: what decoders look up about subtasks: keys and values of those that are left, what is added to
    /// those of agents that were given them, keys to point at, and what is added to agents themselves.
    pub(super) fn encode(&self, pass: &mut Pass<'_>, rows: &[f32]) -> Var {
        let rows = pass.input(self.columns[0], rows);
        let subtasks = pass.size(rows)[0];
        let mut all = VisibleLists::default();
        for _ in 0..subtasks {
            (0..subtasks).for_each(|subtask| all.push(subtask));
            all.end_list();
        }
        let mut x = pass.linear(rows, self.embedding);
        for (keys_values, layer) in &self.layers {
            let normal = pass.normalise_rows(x);
            let keys_values = pass.linear(normal, *keys_values);
            x = layer.pass(pass, x, keys_values, &all);
        }
        let x = pass.normalise_rows(x);
        pass.linear(x, self.tables)
    }

    /// Keys and values of other agents: what they are, and what they were given.
    fn others(&self, pass: &mut Pass<'_>, given: Var, decisions: &Decisions) -> Var {
        let agents = pass.input(self.columns[1] + 1, &decisions.agents);
        let agents = pass.linear(agents, self.agents);
        let given = looked_up(pass, given, &decisions.given);
        pass.add(agents, given)
    }

    /// `[decisions, subtasks]`: the scores of all subtasks in each decision.
    pub(super) fn scores(&self, pass: &mut Pass<'_>, tables: Var, decisions: &Decisions) -> Var {
        let width = self.width;
        let query = self.query(pass, tables, decisions);
        let keys = pass.columns(tables, 4 * width..5 * width);
        let scores = pass.product_transposed(query, keys);
        let scores = pass.scale(scores, 1.0 / (width as f32).sqrt());
        let scores = pass.tanh(scores);
        pass.scale(scores, BOUND)
    }

    /// `[decisions, width]`: the vectors that point.
    pub(super) fn query(&self, pass: &mut Pass<'_>, tables: Var, decisions: &Decisions) -> Var {
        let width = self.width;
        let parts = [0..2 * width, 2 * width..4 * width, 5 * width..6 * width];
        let [left, given, own] = parts.map(|columns| pass.columns(tables, columns));
        let mut seen = vec![left];
        if !decisions.agents.is_empty() {
            seen.push(self.others(pass, given, decisions));
        }
        let keys_values = pass.stack(&seen);
        let context = pass.input(self.context.shape.input, &decisions.contexts);
        let own = looked_up(pass, own, &decisions.own);
        let x = pass.linear(context, self.context);
        let x = pass.add(x, own);
        let x = self.decoder.pass(pass, x, keys_values, &decisions.seen);
        let x = pass.normalise_rows(x);
        pass.linear(x, self.pointer)
    }
}

/// What values allocations: the network that proposes once more, with weights of its own, whose vector makes a number.
#[derive(Clone, Debug)]
pub(super) struct Critic {
    pub(super) network: Network,
    value: Linear,
}

impl Critic {
    /// Draws the first weights, as [`Network::new`] does.
    pub(super) fn new(
        config: &NetworkConfig,
        columns: [usize; 2],
        random: &mut Generator,
    ) -> Result<(Self, Parameters), LearnError> {
        let (network, mut parameters) = Network::new(config, columns, random)?;
        let value = parameters.linear("value", config.width, 1, random);
        Ok((Self { network, value }, parameters))
    }

    /// `[situations, 1]`: what is still to be earned.
    pub(super) fn values(&self, pass: &mut Pass<'_>, tables: Var, situations: &Decisions) -> Var {
        let vectors = self.network.query(pass, tables, situations);
        let vectors = pass.tanh(vectors);
        pass.linear(vectors, self.value)
    }
}

/// Rows by their places, zeros for what is behind all of them.
fn looked_up(pass: &mut Pass<'_>, rows: Var, places: &[u32]) -> Var {
    let columns = pass.size(rows)[1];
    let nothing = pass.input(columns, &vec![0.0; columns]);
    let rows = pass.stack(&[rows, nothing]);
    pass.gather(rows, places)
}
