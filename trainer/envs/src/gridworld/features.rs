//! What an agent sees, column by column.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::bytes::State;
use super::episode::Rules;
use super::map::{NONE, SIDE};
use crate::observation::members;
use crate::rows::SparseRows;

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
        push(look.column.into(), state.probability(look.pit) as f32);
    } else if look.column != NONE {
        push(look.column.into(), 1.0);
    }
    members(state.found(agent).into()).for_each(|treasure| push(LOOKS + treasure, 1.0));
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
