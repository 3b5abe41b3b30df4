//! The window that the agent sees, as the features of an observation, and what a game says of itself.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;

use super::VERSION;
use super::rules::{Rules, state_bytes};
use super::world::{EMPTY, Game, WALL, World};
use crate::picture::{Cell, Disc, Field, Picture};
use crate::rows::SparseRows;
use crate::spec::{Metric, Shape, Sign, Spec, View};

/// Cells that are seen to each side.
pub const RADIUS: usize = 5;
/// Rows and columns of the window.
pub const WINDOW: usize = 2 * RADIUS + 1;
/// The cell of the window that shows what the agent carries instead of what is there.
const HAND: usize = (WINDOW - 1) * WINDOW + RADIUS;
/// Rows and columns of the largest grid with walls around it as wide as the window reaches.
const PADDED: usize = 12 + 2 * RADIUS;

/// `[direction][cell of the window]`: how much further a cell is in a padded grid, from the window's first corner.
const STEPS: [[u16; WINDOW * WINDOW]; 4] = steps();

const fn steps() -> [[u16; WINDOW * WINDOW]; 4] {
    let mut steps = [[0; WINDOW * WINDOW]; 4];
    let mut direction = 0;
    while direction < 4 {
        let (ahead_x, ahead_y) = [(1, 0), (0, 1), (-1, 0), (0, -1)][direction];
        let mut cell = 0;
        while cell < WINDOW * WINDOW {
            let right = (cell % WINDOW) as i32 - RADIUS as i32;
            let ahead = RADIUS as i32 - (cell / WINDOW) as i32;
            let x = ahead * ahead_x - right * ahead_y + RADIUS as i32;
            let y = ahead * ahead_y + right * ahead_x + RADIUS as i32;
            steps[direction][cell] = (y * PADDED as i32 + x) as u16;
            cell += 1;
        }
        direction += 1;
    }
    steps
}

/// `[11 * 11]`: the object of each cell of the window, row by row from the top; the agent stands in the middle and looks
/// up. Outside the grid are walls. The cell farthest behind the agent shows what it carries.
pub fn window(world: &World) -> [u8; WINDOW * WINDOW] {
    let size = usize::from(world.size);
    let mut padded = [WALL; PADDED * PADDED];
    let rows = padded[RADIUS * PADDED + RADIUS..].chunks_mut(PADDED);
    for (to, row) in rows.zip(world.cells[..size * size].chunks_exact(size)) {
        to[..size].copy_from_slice(row);
    }
    let (x, y) = (usize::from(world.position) % size, usize::from(world.position) / size);
    let seen = &padded[y * PADDED + x..][..SEEN];
    let mut window = STEPS[usize::from(world.direction & 3)].map(|step| seen[usize::from(step)]);
    window[HAND] = world.carried;
    window
}

/// Cells of the padded grid from the window's first corner to its last.
const SEEN: usize = (WINDOW - 1) * PADDED + WINDOW;

/// Columns of one cell: its object's, then its state's. Empty cells and the agent, always in the middle, have none.
pub(super) const fn channels<G: Game>() -> usize {
    G::OBJECTS.len() - FIRST + G::STATES.len()
}

/// The first object with a column: after the empty cell and the agent.
const FIRST: usize = WALL as usize;

/// Columns of a row: cell by cell its channels, then the items.
pub(super) const fn columns<G: Game>() -> usize {
    WINDOW * WINDOW * channels::<G>() + G::ITEMS.len()
}

/// Writes what the agent sees and carries; in a mirror, left for right.
pub(super) fn write_row<G: Game>(world: &World, is_mirrored: bool, rows: &mut SparseRows) {
    let window = window(world);
    let states: [u8; 16] = core::array::from_fn(|object| G::state(world, object as u8));
    let mut features = [(0, 1.0); 2 * WINDOW + 2];
    for top in (0..window.len()).step_by(WINDOW) {
        let mut count = 0;
        for cell in top..top + WINDOW {
            let from = if is_mirrored { 2 * top + WINDOW - 1 - cell } else { cell };
            let object = window[from];
            let is_there = usize::from(object != EMPTY);
            let first = (cell * channels::<G>()) as u16;
            // What an empty cell writes the next one overwrites, which costs less than not to write it.
            features[count].0 = (first + u16::from(object)).wrapping_sub(FIRST as u16);
            count += is_there;
            if !G::STATES.is_empty() {
                let state = u16::from(states[usize::from(object) & 15]);
                features[count].0 = first + (G::OBJECTS.len() - FIRST) as u16 + state;
                count += is_there;
            }
        }
        rows.push_all(&features[..count]);
    }
    let items = WINDOW * WINDOW * channels::<G>();
    for (item, count) in world.inventory[..G::ITEMS.len()].iter().enumerate() {
        if *count > 0 {
            rows.push(items + item, f32::from(*count));
        }
    }
    rows.end_row();
}

/// What episodes are measured by: how many milestones they reached, and of each whether they did.
fn metrics(milestones: &[&'static str]) -> Vec<Metric> {
    let reached = Metric::reported("milestones", "milestones", "different milestones reached");
    let each = milestones.iter().map(|name| Metric::reported(name, "share", name));
    core::iter::once(reached).chain(each).collect()
}

/// No milestone can be had any more.
pub(super) const IMPOSSIBLE: &str = "impossible";
/// The time ran out.
pub(super) const TIME: &str = "time";

/// What a game with these rules says of itself.
pub(super) fn spec<G: Game>(rules: &Rules) -> Spec {
    let features = columns::<G>();
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_string()).collect::<Vec<_>>();
    let units = |column| if column < features - G::ITEMS.len() { "0 or 1" } else { "items" };
    let cells = WINDOW * WINDOW;
    Spec {
        name: G::NAME.into(),
        version: VERSION,
        shape: Shape { agents: 1, entities: 1, tasks: 0, actions: G::ACTIONS.len(), features },
        view: View::Pictures([channels::<G>(), WINDOW, WINDOW]),
        features: feature_names::<G>(),
        units: (0..features).map(units).collect(),
        actions: names(G::ACTIONS),
        safe_action: Some(0),
        metrics: metrics(G::MILESTONES),
        causes: &[IMPOSSIBLE, TIME],
        milestones: names(&rules.milestones.names::<G>()),
        signs: signs::<G>(rules),
        turns: 2,
        row_entries: cells * (1 + usize::from(!G::STATES.is_empty())) + G::ITEMS.len(),
        state_bytes: state_bytes::<G>(),
        episode_limit: rules.limit.max(rules.training_limit).into(),
        ..Spec::default()
    }
}

/// How the milestones in use show in what is carried.
fn signs<G: Game>(rules: &Rules) -> Vec<Sign> {
    let first = columns::<G>() - G::ITEMS.len();
    let used = rules.milestones.bits();
    let signs = G::SIGNS.iter().enumerate().filter(|(milestone, _)| used >> milestone & 1 == 1);
    signs
        .map(|(_, (item, change))| Sign { feature: first + usize::from(*item), change: *change })
        .collect()
}

/// Such as `ahead2.left1.tree`, and `items.log`.
fn feature_names<G: Game>() -> Vec<String> {
    let kinds = || G::OBJECTS[2..].iter().chain(G::STATES);
    let side = |place: usize, [before, behind]: [&str; 2]| match place.checked_sub(RADIUS) {
        None => format!("{before}{}", RADIUS - place),
        Some(0) => format!("{before}0"),
        Some(distance) => format!("{behind}{distance}"),
    };
    let cells = (0..WINDOW * WINDOW).flat_map(|cell| {
        let ahead = side(cell / WINDOW, ["ahead", "behind"]);
        let across = side(cell % WINDOW, ["left", "right"]);
        kinds().map(move |kind| format!("{ahead}.{across}.{kind}"))
    });
    cells.chain(G::ITEMS.iter().map(|item| format!("items.{item}"))).collect()
}

/// What a grid looks like. Objects have two letters, no two kinds the same ones, and are written large where they are open.
pub(super) fn picture<G: Game>(world: &World) -> Picture {
    let size = usize::from(world.size);
    let place = |cell: usize| [(cell % size) as f64, (cell / size) as f64];
    let signs = letters_of(G::OBJECTS);
    let cells = world.cells[..size * size].iter().enumerate().map(|(cell, object)| {
        let kind = G::OBJECTS[usize::from(*object)].replace('_', " ");
        let sign = &signs[usize::from(*object)];
        let has_label = !matches!(*object, EMPTY | WALL);
        let label = if world.is_open(*object) { sign.to_uppercase() } else { sign.clone() };
        Cell {
            place: place(cell),
            kind: if *object == EMPTY { String::new() } else { kind },
            label: if has_label { label } else { String::new() },
            is_solid: *object == WALL,
            colour: has_label.then_some(*object),
        }
    });
    let carried = G::ITEMS.iter().zip(&world.inventory).filter(|(_, count)| **count > 0);
    let carried = carried.map(|(item, count)| format!("{count} {}", item.replace('_', " ")));
    let carried = carried.collect::<Vec<_>>().join(", ");
    let agent = Disc {
        name: "agent".into(),
        label: [">", "v", "<", "^"][usize::from(world.direction & 3)].into(),
        kind: "agent",
        place: Some(place(world.position.into())),
        about: format!("carries {}", if carried.is_empty() { "nothing" } else { &carried }),
        ..Disc::default()
    };
    Picture {
        field: Some(Field::grid(size, size)),
        cells: cells.collect(),
        agents: vec![agent],
        ..Picture::default()
    }
}

/// The first letter of each name with another of its letters, of its second word if it can be.
fn letters_of(names: &[&str]) -> Vec<String> {
    let mut signs: Vec<String> = Vec::new();
    for name in names {
        let (first, rest) = name.split_at(1);
        let second = name.split('_').skip(1).filter_map(|word| word.chars().next());
        let letters = second.chain(rest.chars().filter(|letter| *letter != '_'));
        let mut found = letters.map(|letter| format!("{first}{letter}"));
        let sign = found.find(|sign| !signs.contains(sign));
        signs.push(sign.unwrap_or_else(|| name.chars().take(2).collect()));
    }
    signs
}
