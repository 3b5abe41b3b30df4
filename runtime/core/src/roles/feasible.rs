//! What an allocation may say.

use crate::allocator::{AllocateError, Allocator, UNASSIGNED};
use crate::limits;
use crate::wire::FrameView;

/// Writes a feasible allocation of a frame: absent agents have no subtask, whatever the rules gave them.
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
    allocator.allocate(&view.allocation_state(), of_agents)?;
    let present = view.present();
    for (agent, task) in of_agents.iter_mut().enumerate() {
        if !present.contains(agent) {
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
