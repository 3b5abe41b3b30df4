//! `agent.onnx` of agents that look their answers up in a table.
//!
//! One graph holds the tables of all agents. What an agent sees becomes two whole numbers, a place and what it holds;
//! its number, and these, are the row.

use super::attention::{ExportError, check};
use super::onnx::{Attribute, Dim, Element, Graph};
use super::own_row::AGENT_NUMBER;

/// Tables of answers, by agents, by what they hold, by places.
#[derive(Clone, Debug, PartialEq)]
pub struct LookupTables {
    /// `[d]`: the cell is the sum of the observation times these, rounded.
    pub cell: Vec<f32>,
    /// `[d]`: the level is the sum of the observation times these.
    pub level: Vec<f32>,
    /// What the level has to reach to be one of the next kind; rising.
    pub levels: Vec<f32>,
    /// `[d]`: what is held is the sum of the observation times these, rounded.
    pub held: Vec<f32>,
    /// `[levels + 1, cells]`: the place.
    pub places: Vec<u32>,
    /// By what is held: its number in the table.
    pub holdings: Vec<u32>,
    /// `[agents, holdings, places, U]`
    pub answers: Vec<f32>,
    /// Agents.
    pub agents: usize,
    /// Actions U.
    pub actions: usize,
}

impl LookupTables {
    /// How many places the table has, and how many kinds of what is held.
    fn sizes(&self) -> [usize; 2] {
        let count = |numbers: &[u32]| numbers.iter().max().map_or(0, |most| *most as usize + 1);
        [count(&self.places), count(&self.holdings)]
    }

    /// Writes them as ONNX: `observation f32 [1, d], agent i64 [1] -> logits f32 [1, U]`.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_onnx(&self, contract: u64) -> Result<Vec<u8>, ExportError> {
        let [places, holdings] = self.sizes();
        check("table.answers", &self.answers, self.agents * holdings * places * self.actions)?;
        let mut graph = Graph::default();
        let columns = self.cell.len();
        let shape = [Dim::Fixed(1), Dim::Fixed(columns)];
        graph.input("observation", Element::Float, &shape, "the agent's own row");
        graph.input(AGENT_NUMBER, Element::Int64, &[Dim::Fixed(1)], "the agent's number");
        let shape = [Dim::Fixed(1), Dim::Fixed(self.actions)];
        graph.output("logits", Element::Float, &shape, "scores of the actions");
        graph.integers("one", &[1]);
        graph.floats("half", &[1, 1], &[0.5]);

        let cell = rounded(&mut graph, "cell", &self.cell);
        let kind = self.add_kind(&mut graph);
        let place = graph.node("place.number", "Add", &[&cell, &kind], &[]);
        let place = looked_up(&mut graph, "place", &self.places, 1, &place);
        let held = rounded(&mut graph, "held", &self.held);
        let held = looked_up(&mut graph, "holding", &self.holdings, places, &held);
        let firsts: Vec<u32> = (0..self.agents as u32).collect();
        let own = floats(&mut graph, "own", &firsts, holdings * places);
        let own = graph.node("own.first", "Gather", &[&own, AGENT_NUMBER], &[]);
        let within = graph.node("row.within", "Add", &[&place, &held], &[]);
        let row = graph.node("row.number", "Add", &[&within, &own], &[]);
        let row = whole(&mut graph, "row", &row);
        let shape = [self.answers.len() / self.actions, self.actions];
        graph.floats("answers", &shape, &self.answers);
        graph.node("logits", "Gather", &["answers", &row], &[]);
        let metadata = [
            ("sortie.graph", "policy".to_owned()),
            ("sortie.format", "1".to_owned()),
            ("sortie.contract", format!("{contract:016x}")),
        ];
        Ok(graph.into_model("agent", DOC, &metadata))
    }

    /// Adds the cells to skip for the kind that the level is of.
    fn add_kind(&self, graph: &mut Graph) -> String {
        let cells = self.places.len() / (self.levels.len() + 1);
        graph.floats("level.weight", &[self.level.len(), 1], &self.level);
        let level = graph.node("level", "MatMul", &["observation", "level.weight"], &[]);
        graph.floats("level.least", &[1, self.levels.len()], &self.levels);
        let reached = graph.node("level.reached", "GreaterOrEqual", &[&level, "level.least"], &[]);
        let to = [Attribute::Int("to", Element::Float.id())];
        let reached = graph.node("level.flags", "Cast", &[&reached], &to);
        let skips = vec![cells as f32; self.levels.len()];
        graph.floats("level.cells", &[self.levels.len(), 1], &skips);
        graph.node("level.skipped", "MatMul", &[&reached, "level.cells"], &[])
    }
}

const DOC: &str = "Scores of one agent's actions, looked up by its own row and its number.";

/// Adds the sum of the observation times some weights, rounded.
fn rounded(graph: &mut Graph, name: &str, weights: &[f32]) -> String {
    let named = |what: &str| format!("{name}.{what}");
    graph.floats(&named("weight"), &[weights.len(), 1], weights);
    let sum = graph.node(&named("sum"), "MatMul", &["observation", &named("weight")], &[]);
    let above = graph.node(&named("above"), "Add", &[&sum, "half"], &[]);
    graph.node(&named("rounded"), "Floor", &[&above], &[])
}

/// Adds a list of whole numbers times a factor, a number a row.
fn floats(graph: &mut Graph, name: &str, numbers: &[u32], factor: usize) -> String {
    let numbers: Vec<f32> =
        numbers.iter().map(|number| (*number as usize * factor) as f32).collect();
    graph.floats(name, &[numbers.len(), 1], &numbers).to_owned()
}

/// Adds the number that such a list has at a place; at the nearest place where there is none, so that every
/// observation has an answer.
fn looked_up(graph: &mut Graph, name: &str, numbers: &[u32], factor: usize, at: &str) -> String {
    let list = floats(graph, &format!("{name}.list"), numbers, factor);
    let (least, most) = (format!("{name}.least"), format!("{name}.most"));
    graph.floats(&least, &[1, 1], &[0.0]);
    graph.floats(&most, &[1, 1], &[numbers.len().saturating_sub(1) as f32]);
    let at = graph.node(&format!("{name}.above"), "Max", &[at, &least], &[]);
    let at = graph.node(&format!("{name}.inside"), "Min", &[&at, &most], &[]);
    let at = whole(graph, name, &at);
    graph.node(&format!("{name}.found"), "Gather", &[&list, &at], &[])
}

/// Adds a number as one that rows are chosen by.
fn whole(graph: &mut Graph, name: &str, number: &str) -> String {
    let to = [Attribute::Int("to", Element::Int64.id())];
    let whole = graph.node(&format!("{name}.whole"), "Cast", &[number], &to);
    graph.node(&format!("{name}.index"), "Reshape", &[&whole, "one"], &[])
}
