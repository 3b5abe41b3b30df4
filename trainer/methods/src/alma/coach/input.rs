//! What a coach sees where its players play: all that exists in a state, things with their subtasks.

use sortie_envs::{Observation, members};

use super::networks::CoachShape;
use crate::alma::agents::{TaskOrder, UtilityInput};

/// Writes a state that is played in, of which everything is seen, for its coach.
pub fn seen_input(
    shape: CoachShape,
    seen: &Observation,
    order: &TaskOrder,
    input: &mut UtilityInput,
) {
    input.clear();
    for entity in members(seen.present) {
        input.rows.push_row(&seen.rows, seen.row_of(entity));
        if let Some(mark) = order.0.get(usize::from(seen.task_of(entity))) {
            input.rows.push(shape.features + usize::from(*mark), 1.0);
        }
        input.rows.end_row();
    }
    for _ in 0..seen.agents() {
        (0..input.rows.len()).for_each(|row| input.visible.push(row));
        input.visible.end_list();
    }
}
