//! What an agent sees, what a gridworld says of itself, and what there is to draw of a state.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::bytes::{State, state_bytes};
use super::map::{DOORS, FIRST_DOOR, MAX_TREASURES, NONE, PIT, SIDE, WALL};
use super::rules::{Pit, Rules};
use super::{ACTION_NAMES, STAY, VERSION};
use crate::environment::StateError;
use crate::observation::members;
use crate::rows::SparseRows;
use crate::spec::{Metric, Shape, Spec, View};

/// Columns of walls and pits.
const LOOKS: usize = 9;
/// Steps in each direction in which others are seen; what they are divided by.
const NEAR: i32 = 3;

/// Columns of a row.
pub(super) fn columns(rules: &Rules) -> usize {
    LOOKS + rules.map.treasures() + 2 * rules.agents()
}

/// Most columns that differ from zero.
pub(super) fn entries(rules: &Rules) -> usize {
    1 + rules.map.treasures() + 2 * rules.agents()
}

/// Their names.
pub(super) fn names(rules: &Rules) -> Vec<String> {
    let sides = ["right", "down", "left", "up"];
    let walls = sides.map(|side| format!("wall-{side}"));
    let pits = ["here"].into_iter().chain(sides).map(|side| format!("pit-{side}"));
    let found = (0..rules.map.treasures()).map(|treasure| format!("found-{treasure}"));
    let own = ["row", "column"].map(|name| name.to_string());
    let others = (1..rules.agents())
        .flat_map(|other| ["rows", "columns"].map(|name| format!("other-{}-{name}", other - 1)));
    walls.into_iter().chain(pits).chain(found).chain(own).chain(others).collect()
}

/// Their units.
pub(super) fn units(rules: &Rules) -> Vec<&'static str> {
    let count = |unit, count| core::iter::repeat_n(unit, count);
    let looks = count("flag", 4).chain(count("probability", 5));
    let found = count("flag", rules.map.treasures());
    let own = count("20 cells", 2);
    looks.chain(found).chain(own).chain(count("3 cells", 2 * (rules.agents() - 1))).collect()
}

/// Writes what an agent sees.
#[inline]
pub(super) fn write_row(rules: &Rules, state: &State<'_>, agent: usize, rows: &mut SparseRows) {
    let mut push = |column: usize, value: f32| {
        if value != 0.0 {
            rows.push(column, value);
        }
    };
    let cell = state.cell(agent);
    let look = rules.map.seen_from(cell);
    if look.pit != NONE {
        push(look.column.into(), state.pit(look.pit.into()).probability as f32);
    } else if look.column != NONE {
        push(look.column.into(), 1.0);
    }
    members(state.found[agent].into()).for_each(|treasure| push(LOOKS + treasure, 1.0));
    let place = |cell: u16| [i32::from(cell) / SIDE as i32, i32::from(cell) % SIDE as i32];
    let own = place(cell);
    let mut column = LOOKS + rules.map.treasures();
    for part in own {
        push(column, (f64::from(part) / SIDE as f64) as f32);
        column += 1;
    }
    for other in (0..rules.agents()).filter(|other| *other != agent) {
        let there = place(state.cell(other));
        let way = [there[0] - own[0], there[1] - own[1]];
        if way.iter().all(|part| part.abs() <= NEAR) {
            push(column, (f64::from(way[0]) / f64::from(NEAR)) as f32);
            push(column + 1, (f64::from(way[1]) / f64::from(NEAR)) as f32);
        }
        column += 2;
    }
}

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "gridworld";

const METRICS: &[Metric] = &[
    Metric {
        name: "treasures",
        unit: "treasures",
        about: "treasures found, one for each agent that found it",
        is_reported: true,
    },
    Metric {
        name: "tiers",
        unit: "tiers",
        about: "tiers of treasures finished",
        is_reported: true,
    },
];

/// What a gridworld with these rules says of itself.
pub(super) fn spec(rules: &Rules) -> Spec {
    let (agents, features) = (rules.agents(), columns(rules));
    let actions = ACTION_NAMES.len();
    Spec {
        name: NAME,
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions, features },
        view: View::Vectors,
        features: names(rules),
        units: units(rules),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(STAY.into()),
        metrics: METRICS,
        row_entries: entries(rules),
        map: rules.map.lines(),
        state_bytes: state_bytes(rules),
        episode_limit: rules.episode_limit,
        ..Spec::default()
    }
}

/// What is in a cell of a map, beside agents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Nothing, or the start of an agent.
    Free,
    /// A wall.
    Wall,
    /// A pit.
    Pit,
    /// A door that opens once so many tiers are finished.
    Door(u8),
    /// A treasure of this kind.
    Treasure(u8),
}

impl Cell {
    /// All cells of a map as [`Spec::map`] has it, row by row.
    pub fn all(spec: &Spec) -> impl Iterator<Item = Self> + '_ {
        spec.map.iter().flat_map(|row| row.bytes()).map(Self::of)
    }

    fn of(character: u8) -> Self {
        const LAST_TREASURE: u8 = b'A' + MAX_TREASURES as u8 - 1;
        const LAST_DOOR: u8 = FIRST_DOOR + DOORS - 1;
        match character {
            WALL => Self::Wall,
            PIT => Self::Pit,
            b'A'..=LAST_TREASURE => Self::Treasure(character - b'A'),
            FIRST_DOOR..=LAST_DOOR => Self::Door(character - FIRST_DOOR + 1),
            _ => Self::Free,
        }
    }
}

/// A state as it is drawn, on the map of its spec.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// `[agents]`: where they are.
    pub cells: Vec<u16>,
    /// `[agents]`: what they found, kinds of treasures as bits.
    pub found: Vec<u8>,
    /// Tiers that are finished.
    pub tiers: u8,
    /// The pits in the order of their cells, each as it was when somebody last looked.
    pub pits: Vec<Pit>,
}

/// What there is to draw of a state.
///
/// # Errors
/// The bytes are no state of this gridworld.
pub fn picture_of(spec: &Spec, state: &[u8]) -> Result<Picture, StateError> {
    let agents = spec.shape.agents;
    let pits = Cell::all(spec).filter(|cell| *cell == Cell::Pit).count();
    let state = State::read((agents, pits), state)?;
    Ok(Picture {
        cells: (0..agents).map(|agent| state.cell(agent)).collect(),
        found: state.found.to_vec(),
        tiers: state.tiers,
        pits: (0..pits).map(|pit| state.pit(pit)).collect(),
    })
}
