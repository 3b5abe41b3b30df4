//! Which actions the next step may be valued by.

use super::super::batch::NO_TASK;

/// Codes from here on name an agent.
const AGENTS: u16 = 1000;

/// Whether an action is available to an agent, given its code and everybody's allocation.
///
/// 0 is not available, 1 is; 2 + t is available to agents allocated to subtask t, 1000 + a to those
/// allocated to the same subtask as agent a. Who has no allocation counts as allocated to subtask 0, as in
/// the public code.
pub fn is_available(code: u16, agent: usize, allocation: &[u8]) -> bool {
    let task = |agent: usize| match allocation.get(agent) {
        Some(task) if *task != NO_TASK => *task,
        _ => 0,
    };
    match code {
        0 => false,
        1 => true,
        2..AGENTS => u16::from(task(agent)) == code - 2,
        AGENTS.. => task(agent) == task(usize::from(code - AGENTS)),
    }
}
