//! What an episode came to.

/// The names of the values of [`EpisodeMetrics::values`], in their order.
pub const METRIC_NAMES: [&str; 5] = ["solved", "return", "length", "matches", "episode_limit"];

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
    /// Whether the time ran out.
    pub timed_out: bool,
}

impl EpisodeMetrics {
    /// The values in the order of [`METRIC_NAMES`].
    pub fn values(&self) -> [f64; METRIC_NAMES.len()] {
        let flag = |value: bool| f64::from(u8::from(value));
        [
            flag(self.solved),
            self.episode_return,
            self.steps.into(),
            self.matches as f64,
            flag(self.timed_out),
        ]
    }
}
