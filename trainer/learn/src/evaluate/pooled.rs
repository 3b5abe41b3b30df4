//! Several evaluations as one.

use std::collections::BTreeMap;

use super::{Evaluation, wilson_interval};

impl Evaluation {
    /// What these evaluations come to as one, every episode counted alike.
    pub fn pooled(parts: &[Self]) -> Self {
        let episodes = parts.iter().map(|part| part.episodes).sum::<usize>();
        let mean = |value: fn(&Self) -> f64| {
            let sum: f64 = parts.iter().map(|part| value(part) * part.episodes as f64).sum();
            sum / episodes.max(1) as f64
        };
        let return_mean = mean(|part| part.return_mean);
        let mut pooled = Self {
            episodes,
            success: 0.0,
            success_ci95: [0.0; 2],
            return_mean,
            return_sd: return_sd(parts, return_mean, episodes),
            length_mean: mean(|part| part.length_mean),
            timeouts: mean(|part| part.timeouts),
            metrics: metrics(parts),
            failures: [].into(),
            by_team: [].into(),
        };
        for part in parts {
            for (cause, count) in &part.failures {
                *pooled.failures.entry(cause.clone()).or_default() += count;
            }
            for (team, success) in &part.by_team {
                let sum = pooled.by_team.entry(team.clone()).or_default();
                sum.episodes += success.episodes;
                sum.solved += success.solved;
            }
        }
        let solved = pooled.by_team.values().map(|team| team.solved).sum();
        pooled.success = solved as f64 / episodes.max(1) as f64;
        pooled.success_ci95 = wilson_interval(solved, episodes);
        pooled
    }
}

/// The means of all metrics, over the parts that have them.
fn metrics(parts: &[Evaluation]) -> BTreeMap<String, f64> {
    let mut sums = BTreeMap::<String, (f64, usize)>::new();
    for part in parts {
        for (name, value) in &part.metrics {
            let (sum, episodes) = sums.entry(name.clone()).or_default();
            *sum += value * part.episodes as f64;
            *episodes += part.episodes;
        }
    }
    let mean = |(sum, episodes): (f64, usize)| sum / episodes.max(1) as f64;
    sums.into_iter().map(|(name, sum)| (name, mean(sum))).collect()
}

/// The spread of all returns about their common mean, from the spread and the mean of each part.
fn return_sd(parts: &[Evaluation], mean: f64, episodes: usize) -> f64 {
    let squares = parts.iter().map(|part| {
        let within = part.return_sd.powi(2) * part.episodes.saturating_sub(1) as f64;
        within + (part.return_mean - mean).powi(2) * part.episodes as f64
    });
    (squares.sum::<f64>() / episodes.saturating_sub(1).max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Episode, Metric, Spec};

    use super::*;

    /// So many episodes, of which no two are alike.
    fn episodes(from: usize, count: usize) -> Vec<Episode> {
        let episode = |number: usize| Episode {
            steps: 3 + number as u32,
            done: true,
            solved: number.is_multiple_of(3),
            timed_out: number.is_multiple_of(5),
            episode_return: (number as f64).sqrt(),
            group: ["BF", "BG", "FG"][number % 3 / (1 + number % 2)].to_owned(),
            metrics: vec![(!number.is_multiple_of(7)).then_some(number as f64)],
            cause: (number % 3 == 1).then_some("late"),
        };
        (from..from + count).map(episode).collect()
    }

    fn summary(episodes: &[Episode]) -> Evaluation {
        const METRICS: &[Metric] =
            &[Metric { name: "burned", unit: "share", about: "burned", is_reported: true }];
        Evaluation::of(&Spec { metrics: METRICS, causes: &["late"], ..Spec::default() }, episodes)
    }

    #[test]
    fn parts_of_unequal_length_are_as_one_evaluation_of_all_episodes() {
        let (some, more) = (episodes(1, 20), episodes(21, 44));
        let all = summary(&[some.clone(), more.clone()].concat());
        let mut pooled = Evaluation::pooled(&[summary(&some), summary(&more)]);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(pooled.success, all.success);
        near(pooled.return_mean, all.return_mean);
        near(pooled.return_sd, all.return_sd);
        near(pooled.length_mean, all.length_mean);
        near(pooled.timeouts, all.timeouts);
        assert_eq!((pooled.episodes, pooled.success_ci95), (64, all.success_ci95));
        assert_eq!((&pooled.failures, &pooled.by_team), (&all.failures, &all.by_team));
        // Means of a metric weigh parts by all their episodes, also by those without a value.
        pooled = Evaluation::pooled(&[summary(&some), summary(&episodes(22, 6))]);
        let [first, second] =
            [summary(&some), summary(&episodes(22, 6))].map(|one| one.metrics["burned"]);
        near(pooled.metrics["burned"], (20.0 * first + 6.0 * second) / 26.0);
    }

    #[test]
    fn one_part_is_itself() {
        let alone = summary(&episodes(5, 30));
        let pooled = Evaluation::pooled(std::slice::from_ref(&alone));
        assert_eq!(pooled.success, alone.success);
        assert_eq!(pooled.by_team, alone.by_team);
    }
}
