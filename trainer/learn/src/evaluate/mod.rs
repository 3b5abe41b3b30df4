//! What measured episodes come to.

mod pooled;
mod score;
mod summary;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use score::Score;

/// What a team achieved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Episodes played.
    pub episodes: usize,
    /// Share of episodes that were solved.
    pub success: f64,
    /// 95 % Wilson interval of the success.
    pub success_ci95: [f64; 2],
    /// Mean of the team's return.
    pub return_mean: f64,
    /// Its standard deviation between episodes.
    pub return_sd: f64,
    /// Mean number of steps.
    pub length_mean: f64,
    /// Share of episodes that ran out of time.
    pub timeouts: f64,
    /// Means of the environment's metrics by their names, over the episodes that have such a value.
    #[serde(flatten)]
    pub metrics: BTreeMap<String, f64>,
    /// Failed episodes by cause; empty where none are told apart.
    pub failures: BTreeMap<String, usize>,
    /// Success by the kind of episode, such as the team's kinds as letters.
    pub by_team: BTreeMap<String, TeamSuccess>,
}

/// How one composition of a team did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TeamSuccess {
    /// Episodes played.
    pub episodes: usize,
    /// Those that were solved.
    pub solved: usize,
}

/// The 95 % Wilson interval of a share.
pub fn wilson_interval(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let z = 1.959_964;
    let (n, p) = (trials as f64, successes as f64 / trials as f64);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wilson_interval_agrees_with_known_values() {
        let [low, high] = wilson_interval(10, 20);
        assert!((low - 0.2993).abs() < 1e-3 && (high - 0.7007).abs() < 1e-3, "{low} {high}");
        assert_eq!(wilson_interval(0, 0), [0.0, 1.0]);
        assert!(wilson_interval(20, 20)[1] <= 1.0);
    }
}
