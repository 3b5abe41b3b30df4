//! What an episode came to.

/// The values of one episode so far, final once it is done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeMetrics {
    /// Whether the last step left all groups gathered.
    pub solved: bool,
    /// Sum of the team's rewards.
    pub episode_return: f64,
    /// Steps so far.
    pub steps: u32,
    /// Groups that have gathered.
    pub matches: usize,
    /// Whether the time ran out, solved or not.
    pub timed_out: bool,
}
