//! What an instance has once.

use super::world::World;

/// How an episode stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    Running,
    Solved,
    /// No milestone can be had any more.
    Impossible,
}

/// What an instance has once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Episode {
    pub(super) world: World,
    pub(super) steps: u16,
    pub(super) limit: u16,
    pub(super) standing: Standing,
    pub(super) episode_return: f64,
    /// The milestones that were reached, as bits by the game's numbers.
    pub(super) reached: u16,
    /// The milestone in use that the last step reached, by its place.
    pub(super) milestone: Option<u8>,
}

impl Episode {
    pub(super) fn is_done(&self) -> bool {
        self.standing != Standing::Running || self.steps >= self.limit
    }
}
