//! The scripted team: each group walks the shorter way to its best cell.

use super::parameters::Parameters;
use super::ring::{Ring, each};
use super::rules::{LEFT, RIGHT, STAY};

/// Writes the action of every agent.
///
/// The best cell of a group is the one that its members have the fewest steps to, together; the first of
/// several. From the opposite side of the ring an agent goes left. An agent of two groups follows the
/// later one.
pub fn walk(parameters: &Parameters, ring: Ring<'_>, actions: &mut [u16]) {
    let cells = parameters.cells;
    let right = |agent: usize, goal: usize| {
        let cell = usize::from(ring.cells[agent]);
        (goal + cells - cell) % cells
    };
    let steps = |agent, goal| right(agent, goal).min((cells - right(agent, goal)) % cells);
    for members in ring.groups() {
        let together = |goal: &usize| each(members).map(|agent| steps(agent, *goal)).sum::<usize>();
        let goal = (0..cells).min_by_key(together).unwrap_or(0);
        for agent in each(members) {
            actions[agent] = match right(agent, goal) {
                0 => STAY,
                right if 2 * right < cells => RIGHT,
                _ => LEFT,
            };
        }
    }
}
