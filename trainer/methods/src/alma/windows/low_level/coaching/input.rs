//! What coach and recognition network see: all that exists in a state, things with their subtasks.

use crate::alma::agents::{TaskOrder, UtilityInput};
use crate::alma::coach::CoachShape;
use crate::alma::windows::batch::Windows;

/// Writes some states: the agents of all of them first, who query, each seeing everything that exists in
/// its state.
///
/// With `recognises`, agents come with the action that they take.
pub fn state_input(
    shape: CoachShape,
    windows: &Windows,
    states: &[usize],
    order: &TaskOrder,
    recognises: bool,
    input: &mut UtilityInput,
) {
    let sizes = windows.shape;
    input.clear();
    let mut write = |state: usize, entity: usize| {
        let row = state * sizes.entities + entity;
        windows.features.row(row).for_each(|(column, value)| input.rows.push(column, value));
        if let Some(mark) = order.0.get(usize::from(windows.entity_task[row])) {
            input.rows.push(shape.features + usize::from(*mark), 1.0);
        }
        if recognises && entity < sizes.agents {
            let action = usize::from(windows.actions[state * sizes.agents + entity]);
            input.rows.push(shape.features + shape.marks + action, 1.0);
        }
        input.rows.end_row();
    };
    let present = |state: usize, entities: std::ops::Range<usize>| {
        entities.filter(move |entity| windows.present[state * sizes.entities + entity])
    };
    let agents = |state: usize| present(state, 0..sizes.agents);
    let others = |state: usize| present(state, sizes.agents..sizes.entities);
    for state in states {
        agents(*state).for_each(|agent| write(*state, agent));
    }
    for state in states {
        others(*state).for_each(|other| write(*state, other));
    }
    let (mut own, mut other) = (0, states.iter().map(|state| agents(*state).count()).sum());
    for state in states {
        let (own_end, other_end) = (own + agents(*state).count(), other + others(*state).count());
        for _ in own..own_end {
            (own..own_end).chain(other..other_end).for_each(|row| input.visible.push(row));
            input.visible.end_list();
        }
        (own, other) = (own_end, other_end);
    }
}
