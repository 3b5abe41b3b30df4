//! The window that the agent sees, as the features of an observation.

use super::game::Game;
use super::world::{EMPTY, WALL, World};
use crate::rows::SparseRows;

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
pub(super) fn write<G: Game>(world: &World, is_mirrored: bool, rows: &mut SparseRows) {
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
