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
    /// Ticks in a row in which nobody answered for each agent; a process that takes the seat begins anew.
    silent: [u32; limits::AGENTS],
    /// Bit a: nobody acts for agent a, and has not for so long that it is not counted on.
    absent: u64,
    /// The world's own process acts for agents whose seats are free: nobody is absent.
    fills: bool,
    /// The allocator that leads, or did last.
    leader: Option<u32>,
    changed: bool,
    /// Processes that took a seat from another one.
    restarts: u64,
}

impl Default for Seats {
    fn default() -> Self {
        Self::without(0)
    }
}

impl Seats {
    /// Free seats, of which these are of agents that are absent from the beginning: bit a for agent a.
    pub(super) fn without(absent: u64) -> Self {
        let none = [0; limits::AGENTS];
        Self {
            joined: 0,
            owners: none,
            silent: none,
            absent,
            fills: false,
            leader: None,
            changed: false,
            restarts: 0,
        }
    }

    /// Bit a: a process acts for agent a.
    pub(super) fn joined(&self) -> u64 {
        self.joined
    }

    /// Has the world's own process act for agents whose seats are free.
    pub(super) fn fill(&mut self) {
        (self.fills, self.absent) = (true, 0);
    }

    /// Bit a: the world's own process acts for agent a.
    pub(super) fn filled(&self) -> u64 {
        if self.fills { !self.joined } else { 0 }
    }

    /// Bit a: nobody acts for agent a, who is left out of allocations.
    pub(super) fn absent(&self) -> u64 {
        self.absent
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

    /// Whether seats were taken, or agents became absent or came back, since the last call.
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
        let is_new = core::mem::replace(owner, process) != process;
        if self.joined >> agent & 1 == 0 || is_new {
            self.joined |= 1 << agent;
            self.changed = true;
            self.hear(agent);
        }
        // One that takes its seat again has to act first: whoever is too slow takes it again and again.
        if is_new {
            self.set_absent(agent, false);
        }
    }

    fn hear(&mut self, agent: usize) {
        if let Some(silent) = self.silent.get_mut(agent) {
            *silent = 0;
        }
    }

    /// An agent has become absent, or has come back.
    fn set_absent(&mut self, agent: usize, is_absent: bool) {
        if !self.fills && (self.absent >> agent & 1 == 1) != is_absent {
            self.absent ^= 1 << agent;
            self.changed = true;
        }
    }

    /// Frees a seat if `process` holds it: the goodbye of an earlier holder may come late.
    pub(super) fn leave(&mut self, agent: usize, process: u32) {
        if self.owners.get(agent) == Some(&process) {
            self.joined &= !(1 << agent);
        }
    }

    /// After a tick: of the agents that exist, those for which nobody acted are silent. One that is silent for
    /// `absent_after` ticks in a row is absent, and its seat vacant, until another process takes it or somebody acts.
    pub(super) fn note_answers(&mut self, present: u64, acted: u64, absent_after: u32) {
        for agent in (0..limits::AGENTS).filter(|agent| present >> agent & 1 == 1) {
            if acted >> agent & 1 == 1 {
                self.hear(agent);
                self.set_absent(agent, false);
            } else if let Some(silent) = self.silent.get_mut(agent) {
                *silent = silent.saturating_add(1);
                if *silent >= absent_after {
                    self.joined &= !(1 << agent);
                    self.set_absent(agent, true);
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
        assert_eq!((seats.joined(), seats.absent(), seats.take_changed()), (0b10, 0b1, true));
        // It is heard of again, and acts again.
        seats.note(&status(Role::Runner, 5, 0));
        seats.note_answers(0b1, 0, 3);
        assert_eq!((seats.joined(), seats.absent(), seats.take_changed()), (0b11, 0b1, true));
        seats.note_answers(0b1, 0b1, 3);
        assert_eq!((seats.absent(), seats.take_changed()), (0, true));
        seats.note_answers(0b1, 0b1, 3);
        assert!(!seats.take_changed());
        // Another process is counted on at once.
        (0..3).for_each(|_| seats.note_answers(0b1, 0, 3));
        assert_eq!((seats.absent(), seats.take_changed()), (0b1, true));
        seats.note(&status(Role::Runner, 6, 0));
        assert_eq!((seats.joined(), seats.absent(), seats.take_changed()), (0b11, 0, true));
    }

    #[test]
    fn whoever_leaves_is_absent_as_late_as_whoever_falls_silent() {
        let mut seats = Seats::default();
        for (pid, absent) in [(5, [0, 0, 0b1]), (6, [0; 3])] {
            seats.note(&status(Role::Runner, pid, 0));
            seats.leave(0, pid);
            let answered = if pid == 5 { [0; 3] } else { [0, 0b1, 0] };
            for (answered, absent) in answered.into_iter().zip(absent) {
                seats.note_answers(0b1, answered, 3);
                assert_eq!((seats.absent(), seats.joined()), (absent, 0b10), "process {pid}");
            }
        }
    }

    #[test]
    fn an_agent_that_is_absent_from_the_beginning_is_so_until_somebody_acts_for_it() {
        let mut seats = Seats::without(0b10);
        seats.note_answers(0b11, 0b01, 3);
        assert_eq!((seats.absent(), seats.take_changed()), (0b10, false));
        seats.note_answers(0b11, 0b11, 3);
        assert_eq!((seats.absent(), seats.take_changed()), (0, true));
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
