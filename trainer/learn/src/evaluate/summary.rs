//! What episodes come to together.

use std::collections::BTreeMap;

use sortie_envs::{Episode, Metric, Spec};

use super::{Evaluation, TeamSuccess, wilson_interval};

impl Evaluation {
    /// What finished episodes of an environment come to.
    pub fn of(spec: &Spec, episodes: &[Episode]) -> Self {
        let count = episodes.len();
        let mean = |value: &dyn Fn(&Episode) -> f64| {
            episodes.iter().map(value).sum::<f64>() / count.max(1) as f64
        };
        let share =
            |holds: &dyn Fn(&Episode) -> bool| mean(&|episode| f64::from(u8::from(holds(episode))));
        let return_mean = mean(&|episode| episode.episode_return);
        let spread: f64 = episodes.iter().map(|e| (e.episode_return - return_mean).powi(2)).sum();
        let mut by_team = BTreeMap::<String, TeamSuccess>::new();
        for episode in episodes {
            let entry = by_team.entry(episode.group.clone()).or_default();
            entry.episodes += 1;
            entry.solved += usize::from(episode.solved);
        }
        let failed = |cause: &&str| episodes.iter().filter(|e| e.cause == Some(*cause)).count();
        let failures = spec.causes.iter().map(|cause| ((*cause).to_owned(), failed(cause)));
        let reported = spec.metrics.iter().enumerate().filter(|(_, metric)| metric.is_reported);
        let metric = |(index, metric): (usize, &Metric)| {
            let values = episodes.iter().filter_map(|e| e.metrics.get(index).copied().flatten());
            let values: Vec<f64> = values.collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            (!values.is_empty()).then(|| (metric.name.to_owned(), mean))
        };
        Self {
            episodes: count,
            success: share(&|episode| episode.solved),
            success_ci95: wilson_interval(by_team.values().map(|team| team.solved).sum(), count),
            return_mean,
            return_sd: (spread / count.saturating_sub(1).max(1) as f64).sqrt(),
            length_mean: mean(&|episode| f64::from(episode.steps)),
            timeouts: share(&|episode| episode.timed_out),
            metrics: reported.filter_map(metric).collect(),
            failures: failures.collect(),
            by_team,
        }
    }
}
