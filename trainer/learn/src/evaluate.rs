//! What measured episodes come to, alone and pooled, and what says how good a team is.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_envs::{Episode, Metric, Spec, Split};

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
        Self {
            episodes: count,
            success: share(&|episode| episode.solved),
            success_ci95: wilson_interval(by_team.values().map(|team| team.solved).sum(), count),
            return_mean,
            return_sd: (spread / count.saturating_sub(1).max(1) as f64).sqrt(),
            length_mean: mean(&|episode| f64::from(episode.steps)),
            timeouts: share(&|episode| episode.timed_out),
            metrics: metric_means(spec, episodes.iter().map(|episode| &*episode.metrics)),
            failures: failures.collect(),
            by_team,
        }
    }

    /// What these evaluations come to as one, every episode counted alike.
    pub fn pooled(parts: &[Self]) -> Self {
        let episodes = parts.iter().map(|part| part.episodes).sum::<usize>();
        let mean = |value: fn(&Self) -> f64| {
            let sum: f64 = parts.iter().map(|part| value(part) * part.episodes as f64).sum();
            sum / episodes.max(1) as f64
        };
        let mut failures = BTreeMap::<String, usize>::new();
        let mut by_team = BTreeMap::<String, TeamSuccess>::new();
        for part in parts {
            for (cause, count) in &part.failures {
                *failures.entry(cause.clone()).or_default() += count;
            }
            for (team, success) in &part.by_team {
                let sum = by_team.entry(team.clone()).or_default();
                sum.episodes += success.episodes;
                sum.solved += success.solved;
            }
        }
        let solved = by_team.values().map(|team| team.solved).sum::<usize>();
        let return_mean = mean(|part| part.return_mean);
        Self {
            episodes,
            success: solved as f64 / episodes.max(1) as f64,
            success_ci95: wilson_interval(solved, episodes),
            return_mean,
            return_sd: return_sd(parts, return_mean, episodes),
            length_mean: mean(|part| part.length_mean),
            timeouts: mean(|part| part.timeouts),
            metrics: metrics(parts),
            failures,
            by_team,
        }
    }
}

/// Means of the metrics that evaluations tell, by their names, over the episodes that have such a value.
pub(crate) fn metric_means<'a>(
    spec: &Spec,
    episodes: impl Iterator<Item = &'a [Option<f64>]> + Clone,
) -> BTreeMap<String, f64> {
    let reported = spec.metrics.iter().enumerate().filter(|(_, metric)| metric.is_reported);
    let mean = |(index, metric): (usize, &Metric)| {
        let values = episodes.clone().filter_map(|metrics| metrics.get(index).copied().flatten());
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (!values.is_empty()).then(|| (metric.name.to_string(), mean))
    };
    reported.filter_map(mean).collect()
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

/// What says how good a team is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Score {
    /// The share of solved episodes.
    #[default]
    Success,
    /// The mean return, where no episode can be solved.
    Return,
}

impl Score {
    /// What counts in an environment.
    pub fn of(spec: &Spec) -> Self {
        if spec.has_success { Self::Success } else { Self::Return }
    }

    /// What counts in the environment of this name; success where nobody knows it.
    pub fn of_environment(name: &str) -> Self {
        let opened = sortie_envs::open(name, Split::Test, 0, &Default::default());
        opened.map_or(Self::Success, |environment| Self::of(environment.spec()))
    }

    /// What tables call it.
    pub fn name(self) -> &'static str {
        self.pick("success", "return")
    }

    /// What files call it.
    pub fn key(self) -> &'static str {
        self.pick("success", "return_mean")
    }

    /// What an axis says of it.
    pub fn about(self) -> &'static str {
        self.pick("share of solved episodes", "mean return")
    }

    /// Which of the two it is.
    pub fn pick<T>(self, success: T, return_mean: T) -> T {
        match self {
            Self::Success => success,
            Self::Return => return_mean,
        }
    }

    /// A value as text, to as many places as say something.
    pub fn text(self, value: f64) -> String {
        let places = self.pick(3, 2);
        format!("{value:.places$}")
    }

    /// The ends of an axis that shows these values.
    pub fn range(self, values: impl IntoIterator<Item = f64>) -> [f64; 2] {
        if self == Self::Success {
            return [0.0, 1.0];
        }
        let numbers = values.into_iter().filter(|value| value.is_finite());
        let ends = numbers.fold(None, |ends: Option<[f64; 2]>, value| {
            let [low, high] = ends.unwrap_or([value; 2]);
            Some([low.min(value), high.max(value)])
        });
        let [low, high] = ends.unwrap_or_default();
        [low.floor(), high.ceil().max(low.floor() + 1.0)]
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Episode, Metric, Spec};

    use super::*;

    #[test]
    fn the_wilson_interval_agrees_with_known_values() {
        let [low, high] = wilson_interval(10, 20);
        assert!((low - 0.2993).abs() < 1e-3 && (high - 0.7007).abs() < 1e-3, "{low} {high}");
        // Few successes: the middle lies nearer to a half than they do.
        let [low, high] = wilson_interval(1, 10);
        assert!((low - 0.0179).abs() < 1e-4 && (high - 0.4042).abs() < 1e-4, "{low} {high}");
        assert_eq!(wilson_interval(0, 0), [0.0, 1.0]);
        assert!(wilson_interval(20, 20)[1] <= 1.0);
    }

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
        // A name that is made where the environment is.
        let name = ["burn", "ed"].concat().into();
        let metrics = vec![Metric { name, ..Metric::reported("", "share", "burned") }];
        Evaluation::of(&Spec { metrics, causes: &["late"], ..Spec::default() }, episodes)
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
    fn a_metric_is_the_mean_over_the_episodes_that_have_it() {
        // Of episodes 5 to 9 the one of number 7 has none.
        assert_eq!(summary(&episodes(5, 5)).metrics["burned"], 28.0 / 4.0);
        assert!(summary(&episodes(7, 1)).metrics.is_empty());
    }

    #[test]
    fn one_part_is_itself() {
        let alone = summary(&episodes(5, 30));
        let pooled = Evaluation::pooled(std::slice::from_ref(&alone));
        assert_eq!(pooled.success, alone.success);
        assert_eq!(pooled.by_team, alone.by_team);
    }

    #[test]
    fn returns_count_where_nothing_can_be_solved() {
        for (name, want) in [
            ("save-the-city", Score::Success),
            ("particle/treasure-8", Score::Return),
            ("particle/rover-tower-8", Score::Return),
            ("nowhere/at-all", Score::Success),
        ] {
            assert_eq!(Score::of_environment(name), want, "{name}");
        }
        assert_eq!(Score::Success.pick(0.25, 3.0), 0.25);
        assert_eq!(Score::Return.pick(0.25, 3.0), 3.0);
        assert_eq!(
            (Score::Success.text(0.25), Score::Return.text(-3.0)),
            ("0.250".into(), "-3.00".into())
        );
    }

    #[test]
    fn axes_end_at_whole_numbers() {
        assert_eq!(Score::Success.range([0.3, 7.0]), [0.0, 1.0]);
        assert_eq!(Score::Return.range([-7.5, f64::NAN, 128.2]), [-8.0, 129.0]);
        assert_eq!(Score::Return.range([5.0]), [5.0, 6.0]);
        assert_eq!(Score::Return.range([]), [0.0, 1.0]);
    }
}
