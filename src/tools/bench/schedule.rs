//! How the time of a benchmark is shared out.

use super::rounds::Pace;

/// How the time is spent.
pub(super) struct Schedule<'a> {
    pub(super) paces: &'a [Pace],
    pub(super) seconds_per_case: f64,
}

impl<'a> Schedule<'a> {
    /// Hot calls are short and many; the others wait most of their time, and make three rounds at least.
    pub(super) fn seconds(&self, pace: Pace) -> f64 {
        let share = match pace {
            Pace::Hot => 0.6,
            Pace::Cold => 0.3,
            Pace::Spaced => 0.1,
        };
        self.seconds_per_case * share
    }
}
