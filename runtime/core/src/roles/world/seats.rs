//! Who acts for which agent.

use crate::limits;
use crate::wire::{Role, StatMsg};

/// The seats of the team, and the allocator's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seats {
    joined: u64,
    /// Process that acts for each joined agent.
    owners: [u32; limits::AGENTS],
    allocator: Option<u32>,
    changed: bool,
}

impl Default for Seats {
    fn default() -> Self {
        Self { joined: 0, owners: [0; limits::AGENTS], allocator: None, changed: false }
    }
}

impl Seats {
    /// Bit a: a process acts for agent a.
    pub(super) fn joined(&self) -> u64 {
        self.joined
    }

    pub(super) fn has_allocator(&self) -> bool {
        self.allocator.is_some()
    }

    /// Whether seats were taken or left since the last call.
    pub(super) fn take_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }

    /// Seats a process that says hello, and frees the seats of one that says goodbye.
    pub(super) fn note(&mut self, status: &StatMsg) {
        if status.role == Role::Allocator as u8 {
            self.note_allocator(status);
        } else if status.role == Role::Runner as u8 {
            for agent in (0..limits::AGENTS).filter(|agent| status.agents >> agent & 1 == 1) {
                if status.has(StatMsg::HELLO) {
                    self.join(agent, status.pid);
                } else if status.has(StatMsg::BYE) {
                    self.leave(agent, status.pid);
                }
            }
        }
    }

    fn note_allocator(&mut self, status: &StatMsg) {
        if status.has(StatMsg::HELLO) {
            self.allocator = Some(status.pid);
        } else if status.has(StatMsg::BYE) && self.allocator == Some(status.pid) {
            self.allocator = None;
        }
    }

    fn join(&mut self, agent: usize, process: u32) {
        if let Some(owner) = self.owners.get_mut(agent) {
            *owner = process;
            self.joined |= 1 << agent;
            self.changed = true;
        }
    }

    /// Frees a seat if `process` holds it: the goodbye of an earlier holder may come late.
    pub(super) fn leave(&mut self, agent: usize, process: u32) {
        let is_owner = self.owners.get(agent) == Some(&process);
        if is_owner && self.joined >> agent & 1 == 1 {
            self.joined &= !(1 << agent);
            self.changed = true;
        }
    }
}
