//! The runs of one method, which differ in their seeds, and what they have in common.

use serde::Serialize;

use super::{Point, RunRecord};
use crate::evaluate::Score;

/// Runs under one label.
#[derive(Clone, Debug)]
pub struct Group {
    /// What tables and legends call it.
    pub label: String,
    /// At least one run.
    pub runs: Vec<RunRecord>,
}

/// What is compared of groups: returns where none of their runs could solve anything.
pub(super) fn score(groups: &[Group]) -> Score {
    let mut runs = groups.iter().flat_map(|group| &group.runs).peekable();
    let are_returns = runs.peek().is_some() && runs.all(|run| run.score == Score::Return);
    if are_returns { Score::Return } else { Score::Success }
}

/// What a score is drawn against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Environment steps.
    Steps,
    /// Seconds of processor time.
    Cpu,
}

impl Axis {
    /// Where a point stands on the axis.
    pub fn of(self, point: &Point) -> f64 {
        match self {
            Self::Steps => point.env_steps,
            Self::Cpu => point.cpu_s,
        }
    }
}

/// How a quantity varies between seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean of the seeds.
    pub mean: f64,
    /// Standard deviation between them, where there are two or more.
    pub sd: Option<f64>,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

impl Spread {
    /// The spread of some values; none of no values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().collect();
        let count = values.len() as f64;
        let min = values.iter().copied().reduce(f64::min)?;
        let max = values.iter().copied().reduce(f64::max)?;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let sd = (values.len() > 1).then(|| (squares / (count - 1.0)).sqrt());
        Some(Self { mean, sd, min, max })
    }
}

impl Group {
    /// How seeds vary at every place of the axis where one of them was evaluated.
    ///
    /// A seed has the value of its last evaluation until the next one, and keeps that of its last when
    /// others go on. The samples begin where every seed has been evaluated once.
    pub fn curve(&self, axis: Axis, score: Score) -> Vec<(f64, Spread)> {
        let firsts = self.runs.iter().filter_map(|run| run.curve.first());
        let begin = firsts.map(|point| axis.of(point)).fold(f64::NEG_INFINITY, f64::max);
        let all = self.runs.iter().flat_map(|run| &run.curve);
        let mut places: Vec<f64> =
            all.map(|point| axis.of(point)).filter(|x| *x >= begin).collect();
        places.sort_by(f64::total_cmp);
        places.dedup();
        places.into_iter().filter_map(|x| self.sample(axis, score, x)).collect()
    }

    fn sample(&self, axis: Axis, score: Score, x: f64) -> Option<(f64, Spread)> {
        let known = |run: &RunRecord| {
            let until = run.curve.partition_point(|point| axis.of(point) <= x);
            Some(run.curve.get(until.checked_sub(1)?)?.of(score))
        };
        Some((x, Spread::of(self.runs.iter().filter_map(known))?))
    }

    /// The spread over the seeds of something that each has; none where one lacks it.
    pub(super) fn spread(&self, value: impl Fn(&RunRecord) -> Option<f64>) -> Option<Spread> {
        let values = self.runs.iter().map(value).collect::<Option<Vec<_>>>()?;
        Spread::of(values)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A run with a made-up curve of (steps, success); a step takes a millisecond of processor time.
    pub(in crate::report) fn run(seed: u64, curve: &[(f64, f64)]) -> RunRecord {
        let point = |(env_steps, success): &(f64, f64)| Point {
            env_steps: *env_steps,
            cpu_s: env_steps / 1000.0,
            wall_s: env_steps / 500.0,
            success: *success,
            return_mean: 100.0 * success,
        };
        RunRecord {
            folder: format!("made-up-s{seed}").into(),
            description: toml::Table::new(),
            seed: Some(seed),
            environment: None,
            score: Score::Success,
            curve: curve.iter().map(point).collect(),
            rows: Vec::new(),
            result: None,
        }
    }

    pub(in crate::report) fn group(label: &str, runs: Vec<RunRecord>) -> Group {
        Group { label: label.to_owned(), runs }
    }

    #[test]
    fn a_seed_keeps_its_value_between_evaluations_and_after_its_end() {
        let mut group = group(
            "a",
            vec![
                run(1, &[(10.0, 0.0), (20.0, 0.5), (30.0, 0.75)]),
                run(2, &[(15.0, 0.25), (25.0, 1.0)]),
            ],
        );
        let sample = |(x, Spread { mean, min, max, .. })| [x, mean, min, max];
        let curve = group.curve(Axis::Steps, Score::Success).into_iter().map(sample);
        assert_eq!(
            curve.collect::<Vec<_>>(),
            [
                [15.0, 0.125, 0.0, 0.25],
                [20.0, 0.375, 0.25, 0.5],
                [25.0, 0.75, 0.5, 1.0],
                [30.0, 0.875, 0.75, 1.0],
            ]
        );
        let seconds: Vec<f64> =
            group.curve(Axis::Cpu, Score::Success).iter().map(|(x, _)| *x).collect();
        assert_eq!(seconds, [0.015, 0.02, 0.025, 0.03]);
        let returns = group.curve(Axis::Steps, Score::Return);
        assert_eq!(sample(returns[0]), [15.0, 12.5, 0.0, 25.0]);
        // Whichever seed comes first.
        group.runs.reverse();
        assert_eq!(group.curve(Axis::Steps, Score::Return), returns);
    }

    #[test]
    fn returns_are_compared_where_no_run_could_solve_anything() {
        let of = |scores: &[Score]| {
            let run = |score: &Score| RunRecord { score: *score, ..run(1, &[(10.0, 0.5)]) };
            score(&[group("a", scores.iter().map(run).collect())])
        };
        assert_eq!(of(&[Score::Return, Score::Return]), Score::Return);
        assert_eq!(of(&[Score::Return, Score::Success]), Score::Success);
        assert_eq!(of(&[]), Score::Success);
    }

    #[test]
    fn the_spread_is_that_of_a_sample() {
        assert_eq!(Spread::of([]), None);
        let one = Spread::of([2.0]).unwrap();
        assert_eq!((one.mean, one.sd, one.min, one.max), (2.0, None, 2.0, 2.0));
        let three = Spread::of([1.0, 2.0, 3.0]).unwrap();
        assert_eq!((three.mean, three.sd, three.min, three.max), (2.0, Some(1.0), 1.0, 3.0));
    }
}
