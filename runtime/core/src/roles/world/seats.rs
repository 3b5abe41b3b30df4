//! Who acts for which agent.

use heapless::Vec;

use crate::limits;
use crate::wire::{Role, StatMsg};

/// The seats of the team, and the allocator's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seats {
    joined: u64,
    /// Process that acts for each joined agent.
    owners: [u32; limits::AGENTS],
    /// Ticks in a row that each agent left unanswered.
    silent: [u32; limits::AGENTS],
    /// The allocator that leads, or did last.
    leader: Option<u32>,
    changed: bool,
    /// Processes that took a seat from another one.
    restarts: u64,
}

impl Default for Seats {
    fn default() -> Self {
        let none = [0; limits::AGENTS];
        Self { joined: 0, owners: none, silent: none, leader: None, changed: false, restarts: 0 }
    }
}

impl Seats {
    /// Bit a: a process acts for agent a.
    pub(super) fn joined(&self) -> u64 {
        self.joined
    }

    /// How many processes hold these seats.
    pub(super) fn holders(&self, seats: u64) -> u32 {
        let owners = self.owners.iter().enumerate();
        let mut holders: Vec<u32, { limits::AGENTS }> = Vec::new();
        for (_, owner) in owners.filter(|(agent, _)| seats >> agent & 1 == 1) {
            if !holders.contains(owner) {
                // There is room for one for each agent.
                let _ = holders.push(*owner);
            }
        }
        // The limit of agents fits.
        holders.len() as u32
    }

    /// The process of the allocator that leads.
    pub(super) fn leader(&self) -> Option<u32> {
        self.leader
    }

    pub(super) fn has_leader(&self) -> bool {
        self.leader.is_some()
    }

    /// How many processes took the place of an earlier one.
    pub(super) fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Whether seats were taken or left since the last call.
    pub(super) fn take_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }

    /// Seats a process that is there, and frees the seats of one that says goodbye. Not only a hello
    /// counts: of processes that were there first, a restarted world sees a later status.
    pub(super) fn note(&mut self, status: &StatMsg) {
        let leaves = status.has(StatMsg::BYE);
        if status.role == Role::Allocator as u8 {
            self.note_allocator(status, leaves);
        } else if status.role == Role::Runner as u8 {
            self.restarts += u64::from(!leaves && self.is_successor(status));
            for agent in (0..limits::AGENTS).filter(|agent| status.agents >> agent & 1 == 1) {
                if leaves {
                    self.leave(agent, status.pid);
                } else {
                    self.join(agent, status.pid);
                }
            }
        }
    }

    /// Whether a seat of this process had another holder before.
    fn is_successor(&self, status: &StatMsg) -> bool {
        let owners = self.owners.iter().enumerate();
        let mut owners = owners.filter(|(agent, _)| status.agents >> agent & 1 == 1);
        owners.any(|(_, owner)| *owner != 0 && *owner != status.pid)
    }

    /// Whoever steps down is followed by another: only a leader that leaves leaves none.
    fn note_allocator(&mut self, status: &StatMsg, leaves: bool) {
        if leaves && self.leader == Some(status.pid) {
            self.leader = None;
        } else if !leaves && status.has(StatMsg::LEADER) {
            self.leader = Some(status.pid);
        }
    }

    fn join(&mut self, agent: usize, process: u32) {
        let Some(owner) = self.owners.get_mut(agent) else { return };
        if self.joined >> agent & 1 == 0 || *owner != process {
            *owner = process;
            self.joined |= 1 << agent;
            self.changed = true;
            self.hear(agent);
        }
    }

    fn hear(&mut self, agent: usize) {
        if let Some(silent) = self.silent.get_mut(agent) {
            *silent = 0;
        }
    }

    /// Frees a seat if `process` holds it: the goodbye of an earlier holder may come late.
    pub(super) fn leave(&mut self, agent: usize, process: u32) {
        if self.owners.get(agent) == Some(&process) {
            self.vacate(agent);
        }
    }

    fn vacate(&mut self, agent: usize) {
        if self.joined >> agent & 1 == 1 {
            self.joined &= !(1 << agent);
            self.changed = true;
        }
    }

    /// After a tick: of the agents that were to answer, those that did not are silent. A seat that is
    /// silent for `absent_after` ticks in a row is vacant.
    pub(super) fn note_answers(&mut self, asked: u64, answered: u64, absent_after: u32) {
        for agent in (0..limits::AGENTS).filter(|agent| asked >> agent & 1 == 1) {
            if answered >> agent & 1 == 1 {
                self.hear(agent);
            } else if let Some(silent) = self.silent.get_mut(agent) {
                *silent = silent.saturating_add(1);
                if *silent >= absent_after {
                    self.vacate(agent);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zerocopy::FromZeros;

    fn status(role: Role, pid: u32, flags: u32) -> StatMsg {
        StatMsg { pid, role: role as u8, agents: 0b11, flags, ..StatMsg::new_zeroed() }
    }

    #[test]
    fn a_seat_is_vacant_after_silent_ticks_in_a_row() {
        let mut seats = Seats::default();
        seats.note(&status(Role::Runner, 5, 0));
        assert!(seats.take_changed());
        for answered in [0, 0, 0b1, 0, 0] {
            seats.note_answers(0b1, answered, 3);
        }
        assert_eq!((seats.joined(), seats.take_changed()), (0b11, false));
        seats.note_answers(0b1, 0, 3);
        assert_eq!((seats.joined(), seats.take_changed()), (0b10, true));
        // It is heard of again.
        seats.note(&status(Role::Runner, 5, 0));
        seats.note_answers(0b1, 0, 3);
        assert_eq!((seats.joined(), seats.take_changed()), (0b11, true));
    }

    #[test]
    fn processes_count_once_however_many_seats_they_hold() {
        let mut seats = Seats::default();
        seats.note(&status(Role::Runner, 5, 0));
        seats.note(&StatMsg { agents: 0b100, ..status(Role::Runner, 6, 0) });
        assert_eq!(
            [0b111, 0b011, 0b110, 0b010, 0].map(|missing| seats.holders(missing)),
            [2, 1, 2, 1, 0]
        );
    }

    #[test]
    fn news_of_who_is_there_already_change_nothing() {
        let mut seats = Seats::default();
        seats.note(&status(Role::Runner, 5, StatMsg::HELLO));
        assert!(seats.take_changed());
        seats.note(&status(Role::Runner, 5, 0));
        assert!(!seats.take_changed());
        seats.note(&status(Role::Runner, 6, StatMsg::HELLO));
        assert!(seats.take_changed());
        seats.note(&status(Role::Runner, 5, StatMsg::BYE));
        assert_eq!((seats.joined(), seats.take_changed()), (0b11, false));
        assert_eq!(seats.restarts(), 1);
    }

    #[test]
    fn only_a_leader_is_an_allocator_that_is_there() {
        let mut seats = Seats::default();
        seats.note(&status(Role::Allocator, 7, StatMsg::HELLO));
        assert!(!seats.has_leader());
        seats.note(&status(Role::Allocator, 7, StatMsg::LEADER));
        seats.note(&status(Role::Allocator, 8, 0));
        assert!(seats.has_leader());
        seats.note(&status(Role::Allocator, 8, StatMsg::LEADER));
        seats.note(&status(Role::Allocator, 7, StatMsg::BYE));
        assert!(seats.has_leader());
        seats.note(&status(Role::Allocator, 8, 0));
        assert_eq!(seats.leader(), Some(8));
        seats.note(&status(Role::Allocator, 8, StatMsg::BYE | StatMsg::LEADER));
        assert!(!seats.has_leader());
    }
}
