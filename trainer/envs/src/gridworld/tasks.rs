//! What the treasures are to be found for.

use super::map::{MAX_AGENTS, MAX_TREASURES, Map};
use crate::observation::members;

/// What each agent found: kinds of treasures as bits.
pub type Found = [u8; MAX_AGENTS];

/// When treasures count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Each treasure counts for whoever comes first.
    All,
    /// The treasure that is found first counts, once for each agent.
    Same,
    /// Each agent's own treasure counts.
    Own,
}

impl Task {
    /// Mean, and deviation, of what a step adds to the probability that a pit opens.
    pub(super) fn magnitude(self) -> f64 {
        if self == Self::All { 0.05 } else { 0.005 }
    }

    /// Whether a treasure among the `asked` ones counts for an agent that stands on it.
    #[inline]
    pub(super) fn counts(self, asked: u8, found: &Found, agent: usize, treasure: u8) -> bool {
        let bit = 1 << treasure;
        let known = union(found) & asked;
        asked & bit != 0
            && found[agent] & bit == 0
            && match self {
                Self::All => known & bit == 0,
                Self::Same => known == 0 || known & bit != 0,
                Self::Own => usize::from(treasure) == agent,
            }
    }

    /// Whether all that was asked for is found.
    pub(super) fn is_done(self, asked: u8, found: &[u8]) -> bool {
        match self {
            Self::All => found.iter().fold(0, |all, own| all | own) & asked == asked,
            Self::Same => found.iter().all(|own| own & asked != 0),
            Self::Own => found.iter().enumerate().all(|(agent, own)| own >> agent & 1 == 1),
        }
    }

    /// The treasures that an agent may go for.
    pub(super) fn wanted(self, asked: u8, found: &Found, agent: usize) -> u8 {
        let wants = |treasure: &u8| self.counts(asked, found, agent, *treasure);
        (0..MAX_TREASURES as u8).filter(wants).fold(0, |set, treasure| set | 1 << treasure)
    }
}

pub(super) fn union(found: &Found) -> u8 {
    found.iter().fold(0, |all, own| all | own)
}

/// Writes actions of a team that knows the map: in task [`All`](Task::All) agents share out what is left, else they go
/// for the first that counts. Who needs nothing goes on to another treasure, so as not to stand in the way.
pub(super) fn script(
    map: &Map,
    (task, asked): (Task, u8),
    found: &Found,
    cells: &[u16],
    actions: &mut [u16],
) {
    for (agent, (cell, action)) in cells.iter().zip(actions).enumerate() {
        let wanted = task.wanted(asked, found, agent);
        let turn = if task == Task::All { agent % wanted.count_ones().max(1) as usize } else { 0 };
        let goal = members(wanted.into()).nth(turn);
        let other = (found[agent].trailing_zeros() as usize + 1) % map.treasures();
        *action = map.way(usize::from(*cell), goal.unwrap_or(other)).into();
    }
}
