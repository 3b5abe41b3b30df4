//! What one step does.

use super::parameters::Parameters;
use crate::random::{Random, below, chance};

/// Actions of an agent.
pub const ACTIONS: usize = 3;
/// One cell back, from the first to the last.
pub const LEFT: u16 = 0;
/// Stay.
pub const STAY: u16 = 1;
/// One cell on, from the last to the first.
pub const RIGHT: u16 = 2;

/// What the actions are called.
pub const ACTION_NAMES: [&str; ACTIONS] = ["left", "stay", "right"];

/// Where an action leads on a ring of so many cells.
pub(super) fn moved(cell: u8, action: u16, cells: usize) -> u8 {
    let step = match action {
        LEFT => cells - 1,
        RIGHT => 1,
        _ => 0,
    };
    ((usize::from(cell) + step) % cells) as u8
}

/// The action that happens when this one is asked for.
pub(super) fn slipped(parameters: &Parameters, action: u16, random: &mut Random) -> u16 {
    if chance(random, parameters.noise) { below(random, ACTIONS) as u16 } else { action }
}

/// The reward of a step that changed the number of gathered groups, in the order of operations of the
/// public code.
pub(super) fn reward(before: usize, after: usize) -> f64 {
    -0.1 + 2.5 * (after as f64 - before as f64)
}
