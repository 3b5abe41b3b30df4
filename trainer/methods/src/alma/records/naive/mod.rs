//! What the fast learner computes, written a second time: slowly, in f64, from its rules alone.
//!
//! Tests compare losses with it. It shares neither passes nor batches nor turned maps with what it checks; of the
//! environment it takes dense rows and travel times, which recorded episodes check.

mod agents;
mod allocator;

use sortie_envs::save_the_city::{AgentState, BuildingState, FEATURES};
use sortie_envs::save_the_city::{write_agent_row, write_building_row};

use crate::alma::agents::UtilityNetwork;

type Row = Vec<f64>;

/// What a network says to the entity of the row `own` that sees the rows `seen` (dissertation section 2.3).
fn outputs(network: &UtilityNetwork, own: &Row, seen: &[Row]) -> Vec<f64> {
    let shape = network.shape();
    let weights = network.weights();
    let embed = |row: &Row| rectified(affine(&weights.fc1_weight, &weights.fc1_bias, row));
    let (query, rest) = weights.attention_in_weight.split_at(shape.width * shape.width);
    let (key, value) = rest.split_at(shape.width * shape.width);
    let no_bias = vec![0.0; shape.width];
    let query = affine(query, &no_bias, &embed(own));
    let embedded = || seen.iter().map(embed);
    let keys: Vec<Row> = embedded().map(|row| affine(key, &no_bias, &row)).collect();
    let values: Vec<Row> = embedded().map(|row| affine(value, &no_bias, &row)).collect();

    let mut attended = vec![0.0; shape.width];
    let head = shape.width / shape.heads;
    for start in (0..shape.width).step_by(head) {
        let columns = start..start + head;
        let score = |key: &Row| {
            let products = columns.clone().map(|column| query[column] * key[column]);
            (products.sum::<f64>() / (head as f64).sqrt()).exp()
        };
        let total: f64 = keys.iter().map(score).sum();
        for (key, value) in keys.iter().zip(&values) {
            for column in columns.clone() {
                attended[column] += score(key) / total * value[column];
            }
        }
    }
    let mut looked = affine(&weights.attention_out_weight, &weights.attention_out_bias, &attended);
    if shape.skip {
        let past = affine(&weights.skip_weight, &no_bias, &embed(own));
        looked.iter_mut().zip(past).for_each(|(looked, past)| *looked += past);
    }
    let base = affine(&weights.fc2_weight, &weights.fc2_bias, &rectified(looked));
    affine(&weights.head_weight, &weights.head_bias, &rectified(base))
}

/// `matrix [out, in]` times `input`, plus `bias`.
fn affine(matrix: &[f32], bias: &[f32], input: &[f64]) -> Row {
    let rows = matrix.chunks_exact(input.len()).zip(bias);
    let dot = |row: &[f32]| row.iter().zip(input).map(|(a, b)| f64::from(*a) * b).sum::<f64>();
    rows.map(|(row, bias)| dot(row) + f64::from(*bias)).collect()
}

fn rectified(mut row: Row) -> Row {
    row.iter_mut().for_each(|value| *value = value.max(0.0));
    row
}

/// A row of features, widened by zeros to so many columns.
fn agent_row(agent: &AgentState, columns: usize) -> Row {
    widened(columns, |row| write_agent_row(agent, row))
}

fn building_row(building: &BuildingState, columns: usize) -> Row {
    widened(columns, |row| write_building_row(building, row))
}

fn widened(columns: usize, write: impl Fn(&mut [f32])) -> Row {
    let mut row = [0.0; FEATURES];
    write(&mut row);
    let zeros = std::iter::repeat_n(0.0, columns - FEATURES);
    row.into_iter().map(f64::from).chain(zeros).collect()
}

/// One of the eight ways to look at the map: bits for west and east, for south and north, for the diagonal.
#[derive(Clone, Copy)]
struct Map(u8);

impl Map {
    /// Where a cell is then.
    fn cell(self, (x, y): (i32, i32)) -> (i32, i32) {
        let x = if self.0 & 1 == 0 { x } else { 15 - x };
        let y = if self.0 & 2 == 0 { y } else { 15 - y };
        if self.0 & 4 == 0 { (x, y) } else { (y, x) }
    }

    /// The number of an action then: that of the move between the same two cells.
    fn action(self, action: u8) -> u8 {
        const STEPS: [(i32, i32); 8] =
            [(0, 1), (1, 0), (0, -1), (-1, 0), (0, 2), (2, 0), (0, -2), (-2, 0)];
        let Some((dx, dy)) = STEPS.get(usize::from(action).wrapping_sub(1)) else { return action };
        let (from, to) = (self.cell((7, 7)), self.cell((7 + dx, 7 + dy)));
        let step = (to.0 - from.0, to.1 - from.1);
        1 + STEPS.iter().position(|other| *other == step).unwrap() as u8
    }

    fn agent(self, agent: &AgentState) -> AgentState {
        let (x, y) = self.place(agent.x, agent.y);
        let available = (0..16).filter(|action| agent.available >> action & 1 == 1);
        let available = available.map(|action| 1 << self.action(action)).sum();
        AgentState { x, y, available, ..*agent }
    }

    fn building(self, building: &BuildingState) -> BuildingState {
        let (x, y) = self.place(building.x, building.y);
        BuildingState { x, y, ..*building }
    }

    fn place(self, x: u8, y: u8) -> (u8, u8) {
        let (x, y) = self.cell((x.into(), y.into()));
        (x as u8, y as u8)
    }
}

/// Whether two losses are the same but for rounding.
fn assert_near(what: &str, got: f64, want: f64) {
    assert!((got - want).abs() <= 1e-4 * (0.01 + want), "{what}: {got}, by the rules {want}");
}
