//! What an allocation may say.

use crate::allocator::{AllocateError, Allocator, UNASSIGNED};
use crate::limits;
use crate::wire::FrameView;

/// Writes a feasible allocation of a frame: agents that do not exist, or for which nobody acts, have no subtask,
/// whatever the rules gave them.
///
/// # Errors
/// The rules refuse, or give an agent a subtask that is not open.
pub(super) fn allocate<A: Allocator + ?Sized>(
    allocator: &mut A,
    view: &FrameView<'_>,
    task: &mut [u8; limits::AGENTS],
) -> Result<(), AllocateError> {
    *task = [UNASSIGNED; limits::AGENTS];
    let of_agents = task.get_mut(..view.agents()).unwrap_or_default();
    let state = view.allocation_state();
    if !(0..view.agents()).any(|agent| state.present.contains(agent)) {
        // Rules need not know of teams without anybody.
        return Ok(());
    }
    allocator.allocate(&state, of_agents)?;
    for (agent, task) in of_agents.iter_mut().enumerate() {
        if !state.present.contains(agent) {
            *task = UNASSIGNED;
        } else if *task != UNASSIGNED && !is_open(view, *task) {
            return Err(AllocateError::Infeasible);
        }
    }
    Ok(())
}

/// Whether a subtask is present and not finished.
pub(super) fn is_open(view: &FrameView<'_>, task: u8) -> bool {
    view.open_tasks().checked_shr(task.into()).is_some_and(|tasks| tasks & 1 == 1)
}
