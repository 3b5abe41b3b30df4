//! What the rules of a game leave open.

use super::game::Game;
use super::set::MilestoneSet;

/// What the rules leave open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// The milestones in use, the task last.
    pub milestones: MilestoneSet,
    /// Whether the first of each milestone is paid for, instead of the task alone.
    pub dense: bool,
    /// Chance of each step that an item gets lost.
    pub loss: f64,
    /// Steps after which an episode that is measured is over.
    pub limit: u16,
    /// Steps after which one to learn from is over.
    pub training_limit: u16,
}

impl Rules {
    /// The usual rules of a game for a set of milestones.
    pub fn usual<G: Game>(milestones: MilestoneSet) -> Self {
        let limit = (30 * G::SIZE * G::SIZE) as u16;
        Self { milestones, dense: false, loss: 0.0, limit, training_limit: 1_500 }
    }
}
