//! What an agent sees, what a gridworld says of itself, and what a state looks like.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::bytes::{State, state_bytes};
use super::map::{DOORS, FIRST_DOOR, NONE, PIT, SIDE, WALL};
use super::rules::Rules;
use super::{ACTION_NAMES, STAY, VERSION};
use crate::observation::members;
use crate::picture::{Cell, Disc, Field, Picture, lettered};
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
    Metric::reported("treasures", "treasures", "treasures found, one for each agent that found it"),
    Metric::reported("tiers", "tiers", "tiers of treasures finished"),
];

/// What a gridworld with these rules says of itself.
pub(super) fn spec(rules: &Rules) -> Spec {
    let (agents, features) = (rules.agents(), columns(rules));
    let actions = ACTION_NAMES.len();
    Spec {
        name: NAME.into(),
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions, features },
        view: View::Vectors,
        features: names(rules),
        units: units(rules),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(STAY.into()),
        metrics: METRICS.to_vec(),
        row_entries: entries(rules),
        state_bytes: state_bytes(rules),
        episode_limit: rules.episode_limit,
        ..Spec::default()
    }
}

/// What a state of such a gridworld looks like. Pits have the chance in percent that they open next.
pub(super) fn picture(rules: &Rules, state: &State<'_>) -> Picture {
    let place = |cell: usize| [(cell % SIDE) as f64, (cell / SIDE) as f64];
    let all_found = state.found.iter().fold(0, |all, own| all | own);
    let mut pits = (0..).map(|pit| state.pit(pit));
    let cells = (0..).zip(rules.map.rows()).filter_map(|(cell, character)| {
        let treasure = rules.map.treasure_at(cell);
        let (kind, label, colour) = match *character {
            WALL => ("wall", String::new(), None),
            PIT => match pits.next()? {
                pit if pit.is_open => ("open pit", "!".into(), Some(1)),
                pit => ("pit", format!("{:.0}", (100.0 * pit.probability).min(99.0)), None),
            },
            door if (FIRST_DOOR..FIRST_DOOR + DOORS).contains(&door) => {
                let is_open = rules.map.is_open(cell, state.tiers);
                if is_open { ("open door", "::".into(), None) } else { ("door", "==".into(), None) }
            }
            _ => match all_found >> treasure? & 1 {
                0 => ("treasure", lettered(treasure?.into()), Some(2)),
                _ => ("treasure, found", lettered(treasure?.into()), None),
            },
        };
        let (place, kind, is_solid) = (place(cell.into()), kind.to_string(), kind == "wall");
        Some(Cell { place, kind, label, is_solid, colour })
    });
    let agent = |agent: usize| {
        let found: String = members(state.found[agent].into()).map(lettered).collect();
        let what = if found.is_empty() { "nothing" } else { &found };
        Disc {
            name: agent.to_string(),
            kind: "agent",
            colour: Some(agent as u8),
            place: Some(place(state.cell(agent).into())),
            status: format!("found {what}"),
            ..Disc::default()
        }
    };
    Picture {
        field: Some(Field::grid(SIDE, SIDE)),
        cells: cells.collect(),
        agents: (0..rules.agents()).map(agent).collect(),
        ..Picture::default()
    }
}
