//! How methods did, beside one another.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::group::score;
use super::{Axis, FinalResult, Group, Point, RunRecord, Spread};
use crate::evaluate::{Score, TeamSuccess};

/// Shares of solved episodes of which it is said when a run first reached them.
const LEVELS: [f64; 2] = [0.6, 0.8];

/// What tables and pictures of a comparison show.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Its title.
    pub title: String,
    /// What is compared.
    #[serde(skip)]
    pub score: Score,
    /// One entry per label, in the order given.
    pub groups: Vec<GroupSummary>,
    /// One entry per run, label by label.
    runs: Vec<RunSummary>,
    /// Success by team, if that is compared, for the labels whose runs have a final evaluation.
    pub(super) teams: Vec<TeamSummary>,
    /// Why episodes failed, for the labels whose runs all say so.
    pub(super) causes: Vec<CauseSummary>,
    /// What a reader must know to judge the figures.
    pub notes: Vec<String>,
}

/// How the runs of one label did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupSummary {
    /// The label.
    pub label: String,
    /// Runs.
    pub runs: usize,
    /// Share of solved episodes at the end; absent where nothing can be solved.
    pub success: Option<Spread>,
    /// Where the success is from: `result` (fresh episodes) or `curve` (last evaluation of training).
    pub success_from: &'static str,
    /// The environment's metrics by their names, where all runs say so.
    #[serde(flatten)]
    pub metrics: BTreeMap<String, Spread>,
    /// Share of episodes that ran out of time, where all runs say so.
    pub timeouts: Option<Spread>,
    /// Mean return, where all runs say so.
    pub return_mean: Option<Spread>,
    /// Mean steps of an episode, where all runs say so.
    pub length_mean: Option<Spread>,
    /// Environment steps learned for.
    pub env_steps: Spread,
    /// Seconds of processor time.
    pub cpu_s: Spread,
    /// Seconds by the clock.
    pub wall_s: Spread,
    /// When the runs first reached a level of success, by the level as text: `0.60`.
    pub until: BTreeMap<String, Until>,
}

/// When the runs of a label first reached a level of success in an evaluation during training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Until {
    /// Runs that reached it; the others are left out of the figures.
    pub reached: usize,
    /// Environment steps until then.
    pub env_steps: Option<Reached>,
    /// Seconds of processor time until then.
    pub cpu_s: Option<Reached>,
}

/// What it took the runs that reached a level.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// Mean of the runs.
    pub mean: f64,
    /// Of the fastest.
    pub min: f64,
    /// Of the slowest.
    pub max: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct RunSummary {
    label: String,
    /// Its folder.
    run: String,
    /// Where it says so.
    seed: Option<u64>,
    /// Share of solved episodes: of the final evaluation, else of the last one during training; absent where nothing can
    /// be solved.
    success: Option<f64>,
    env_steps: f64,
    cpu_s: f64,
    wall_s: f64,
}

/// How the runs of a label did with one team.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct TeamSummary {
    /// Its kinds as letters.
    pub(super) team: String,
    pub(super) label: String,
    /// Episodes played, all runs together.
    episodes: usize,
    pub(super) success: Spread,
}

/// How often the runs of a label failed for one cause.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct CauseSummary {
    /// As evaluations name it.
    pub(super) cause: String,
    pub(super) label: String,
    /// Of all episodes, those that failed for it.
    pub(super) share: Spread,
}

impl Comparison {
    /// Compares groups, each of at least one run.
    pub fn of(title: &str, groups: &[Group]) -> Self {
        Self {
            title: title.to_owned(),
            score: score(groups),
            groups: groups.iter().filter_map(GroupSummary::of).collect(),
            runs: groups.iter().flat_map(RunSummary::of).collect(),
            teams: if score(groups) == Score::Success { teams(groups) } else { Vec::new() },
            causes: causes(groups),
            notes: notes(groups),
        }
    }

    /// The levels that tables tell of: shares of solved episodes.
    pub fn levels(&self) -> Vec<&String> {
        let has_levels = |group: &&GroupSummary| !group.until.is_empty();
        let first = self.groups.iter().find(has_levels);
        first.into_iter().flat_map(|group| group.until.keys()).collect()
    }
}

impl GroupSummary {
    /// What is compared of it.
    pub fn of_score(&self, score: Score) -> Option<Spread> {
        score.pick(self.success, self.return_mean)
    }

    fn of(group: &Group) -> Option<Self> {
        let result = |value: &dyn Fn(&FinalResult) -> Option<f64>| {
            group.spread(|run| run.result.as_ref().and_then(value))
        };
        let fresh = has_results(group);
        let last = |value: &dyn Fn(&Point) -> f64| group.spread(|run| Some(value(&run.last())));
        let can_solve = group.runs.iter().any(|run| run.score == Score::Success);
        let success = |run: &RunRecord| match &run.result {
            _ if !can_solve => None,
            Some(result) if fresh => Some(result.success),
            _ => Some(run.last().success),
        };
        let returned = |run: &RunRecord| match &run.result {
            Some(result) => result.return_mean,
            None => (run.score == Score::Return).then_some(run.last().return_mean),
        };
        let level = |level: &f64| (format!("{level:.2}"), Until::of(group, *level));
        Some(Self {
            label: group.label.clone(),
            runs: group.runs.len(),
            success: group.spread(success),
            success_from: if fresh { "result" } else { "curve" },
            metrics: metrics(group),
            timeouts: result(&|result| result.timeouts),
            return_mean: group.spread(returned),
            length_mean: result(&|result| result.length_mean),
            env_steps: last(&|point| point.env_steps)?,
            cpu_s: last(&|point| point.cpu_s)?,
            wall_s: last(&|point| point.wall_s)?,
            until: LEVELS.iter().filter(|_| can_solve).map(level).collect(),
        })
    }
}

impl RunSummary {
    fn of(group: &Group) -> impl Iterator<Item = Self> {
        group.runs.iter().map(|run| Self {
            label: group.label.clone(),
            run: run.folder.display().to_string(),
            seed: run.seed,
            success: (run.score == Score::Success).then(|| run.success()),
            env_steps: run.last().env_steps,
            cpu_s: run.last().cpu_s,
            wall_s: run.last().wall_s,
        })
    }
}

impl Until {
    fn of(group: &Group, level: f64) -> Self {
        let first = |run: &RunRecord| run.curve.iter().find(|p| p.success >= level).copied();
        let first: Vec<Point> = group.runs.iter().filter_map(first).collect();
        let reached = |axis: Axis| {
            let spread = Spread::of(first.iter().map(|point| axis.of(point)))?;
            Some(Reached { mean: spread.mean, min: spread.min, max: spread.max })
        };
        Self { reached: first.len(), env_steps: reached(Axis::Steps), cpu_s: reached(Axis::Cpu) }
    }
}

/// The metrics that the final evaluations of all runs of a group have.
fn metrics(group: &Group) -> BTreeMap<String, Spread> {
    let first = group.runs.first().and_then(|run| run.result.as_ref());
    let names = first.into_iter().flat_map(FinalResult::metrics).map(|(name, _)| name);
    let of = |run: &RunRecord, name: &str| {
        let mut all = run.result.as_ref()?.metrics();
        all.find(|(other, _)| *other == name).map(|(_, value)| value)
    };
    let spread = |name: &str| Some((name.to_owned(), group.spread(|run| of(run, name))?));
    names.filter_map(spread).collect()
}

/// Whether all runs of a group have been evaluated on fresh episodes.
fn has_results(group: &Group) -> bool {
    group.runs.iter().all(|run| run.result.is_some())
}

/// Small teams first, then by their letters; labels in the order given.
fn teams(groups: &[Group]) -> Vec<TeamSummary> {
    let results = results(groups, |_| true);
    let teams = all_names(&results, |result| result.by_team.keys());
    let mut teams: Vec<&String> = teams.into_iter().collect();
    teams.sort_by_key(|team| team.chars().count());
    in_turn(teams, &results, |team, group, results| {
        let played = results.iter().filter_map(|result| result.by_team.get(team));
        let played = played.filter(|team| team.episodes > 0);
        let share = |team: &TeamSuccess| team.solved as f64 / team.episodes as f64;
        Some(TeamSummary {
            team: team.clone(),
            label: group.label.clone(),
            episodes: played.clone().map(|team| team.episodes).sum(),
            success: Spread::of(played.map(share))?,
        })
    })
}

/// Causes in the order of their names; labels in the order given.
fn causes(groups: &[Group]) -> Vec<CauseSummary> {
    let results = results(groups, |result| !result.failures.is_empty() && result.episodes > 0);
    let causes = all_names(&results, |result| result.failures.keys());
    in_turn(causes, &results, |cause, group, results| {
        let share = |result: &&FinalResult| {
            let failed = result.failures.get(cause).copied().unwrap_or(0);
            failed as f64 / result.episodes as f64
        };
        let share = Spread::of(results.iter().map(share))?;
        Some(CauseSummary { cause: cause.clone(), label: group.label.clone(), share })
    })
}

/// A group, and the final evaluations of all of its runs.
type Results<'a> = (&'a Group, Vec<&'a FinalResult>);

/// The groups of whose runs all have such a final evaluation.
fn results(groups: &[Group], told: impl Fn(&FinalResult) -> bool) -> Vec<Results<'_>> {
    let results = |group| {
        let Group { runs, .. }: &Group = group;
        let all: Option<Vec<_>> =
            runs.iter().map(|run| run.result.as_ref().filter(|result| told(result))).collect();
        Some((group, all?))
    };
    groups.iter().filter_map(results).collect()
}

/// The names that any of these evaluations has for something.
fn all_names<'a, I: Iterator<Item = &'a String>>(
    results: &[Results<'a>],
    names: impl Fn(&'a FinalResult) -> I,
) -> BTreeSet<&'a String> {
    results.iter().flat_map(|(_, results)| results).flat_map(|result| names(result)).collect()
}

/// What there is to say of every name and, in turn, of every group.
fn in_turn<'a, S>(
    names: impl IntoIterator<Item = &'a String>,
    results: &[Results<'_>],
    summary: impl Fn(&String, &Group, &[&FinalResult]) -> Option<S>,
) -> Vec<S> {
    let mut all = Vec::new();
    for name in names {
        all.extend(results.iter().filter_map(|(group, results)| summary(name, group, results)));
    }
    all
}

fn notes(groups: &[Group]) -> Vec<String> {
    let mut notes = Vec::new();
    for group in groups {
        let label = &group.label;
        if !has_results(group) {
            notes.push(format!(
                "`{label}`: not every run has a final evaluation, so its success is that of the last evaluation \
                 during training"
            ));
        }
        let steps = Spread::of(group.runs.iter().map(|run| run.last().env_steps));
        if let Some(steps) = steps.filter(|steps| steps.min < steps.max) {
            notes.push(format!(
                "`{label}`: runs end after {} to {} steps; the shorter ones keep their last value in the curves",
                steps.min, steps.max
            ));
        }
    }
    let environments: BTreeSet<&str> = groups
        .iter()
        .flat_map(|group| &group.runs)
        .filter_map(|run| run.environment.as_deref())
        .collect();
    if environments.len() > 1 {
        let names: Vec<&str> = environments.into_iter().collect();
        notes.push(format!("the runs learned in different environments: {}", names.join(", ")));
    }
    notes
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::group::tests::{group, run};
    use super::*;
    use crate::evaluate::TeamSuccess;

    /// A run with a final evaluation: success and solved episodes out of 10 by team.
    pub(in crate::report) fn evaluated(
        seed: u64,
        success: f64,
        teams: &[(&str, usize)],
    ) -> RunRecord {
        let mut run = run(seed, &[(100.0, 0.1), (200.0, 0.7), (300.0, 0.65)]);
        let team = |(name, solved): &(&str, usize)| {
            (name.to_string(), TeamSuccess { episodes: 10, solved: *solved })
        };
        run.result = Some(FinalResult {
            allocation: Some("random".to_owned()),
            episodes: 10 * teams.len(),
            success,
            return_mean: None,
            length_mean: Some(60.0),
            timeouts: Some(0.125),
            failures: [("burned_late".to_owned(), teams.len())].into(),
            by_team: teams.iter().map(team).collect(),
            others: [("tidy".to_owned(), 0.75.into()), ("seed".to_owned(), 7.into())].into(),
        });
        run
    }

    #[test]
    fn runs_of_different_environments_are_noted() {
        let of = |environments: [Option<&str>; 2]| {
            let run = |environment: Option<&str>| {
                let environment = environment.map(str::to_owned);
                RunRecord { environment, ..evaluated(1, 0.5, &[]) }
            };
            Comparison::of("t", &environments.map(|name| group("a", vec![run(name)]))).notes
        };
        let noted = ["the runs learned in different environments: city/a, city/b"];
        assert_eq!(of([Some("city/b"), Some("city/a")]), noted);
        assert!(of([Some("city/a"); 2]).is_empty() && of([Some("city/a"), None]).is_empty());
    }

    #[test]
    fn the_final_evaluation_counts_more_than_the_curve() {
        let runs = vec![evaluated(1, 0.5, &[]), evaluated(2, 0.75, &[])];
        let comparison = Comparison::of("t", &[group("a", runs)]);
        let summary = &comparison.groups[0];
        assert_eq!((summary.success.unwrap().mean, summary.success_from), (0.625, "result"));
        assert_eq!(summary.timeouts.unwrap().mean, 0.125);
        assert_eq!(summary.return_mean, None);
        let metrics: Vec<_> =
            summary.metrics.iter().map(|(name, s)| (name.as_str(), s.mean)).collect();
        assert_eq!(metrics, [("tidy", 0.75)]);
        assert_eq!(comparison.notes, Vec::<String>::new());
    }

    #[test]
    fn a_group_with_one_run_unevaluated_is_judged_by_its_curves() {
        let runs = vec![evaluated(1, 0.5, &[]), run(2, &[(100.0, 0.25)])];
        let comparison = Comparison::of("t", &[group("a", runs)]);
        let summary = &comparison.groups[0];
        assert_eq!((summary.success.unwrap().mean, summary.success_from), (0.45, "curve"));
        assert!(summary.metrics.is_empty());
        assert!(comparison.notes[0].contains("not every run"), "{:?}", comparison.notes);
        assert!(comparison.notes[1].contains("100 to 300"), "{:?}", comparison.notes);
    }

    #[test]
    fn a_level_is_reached_at_the_first_evaluation_above_it() {
        let slow = run(3, &[(100.0, 0.2), (400.0, 0.6)]);
        let never = run(4, &[(100.0, 0.2)]);
        let comparison =
            Comparison::of("t", &[group("a", vec![evaluated(1, 0.5, &[]), slow, never])]);
        let until = &comparison.groups[0].until;
        assert_eq!(until["0.60"].reached, 2);
        let steps = until["0.60"].env_steps.unwrap();
        assert_eq!((steps.mean, steps.min, steps.max), (300.0, 200.0, 400.0));
        assert_eq!(until["0.60"].cpu_s.unwrap().max, 0.4);
        assert_eq!(until["0.80"], Until { reached: 0, env_steps: None, cpu_s: None });
    }

    #[test]
    fn what_an_environment_does_not_have_is_not_shown() {
        let unsolvable = || RunRecord { score: Score::Return, ..run(1, &[(100.0, 0.0)]) };
        let groups =
            [group("returns", vec![unsolvable()]), group("a", vec![evaluated(1, 0.5, &[])])];
        let comparison = Comparison::of("t", &groups);
        let [returns, solving] = &comparison.groups[..] else { panic!("two groups") };
        assert_eq!((returns.success, returns.until.len()), (None, 0));
        assert_eq!((solving.until.len(), comparison.levels().len()), (2, 2));
        assert_eq!(
            comparison.runs.iter().map(|run| run.success).collect::<Vec<_>>(),
            [None, Some(0.5)]
        );
        let text = comparison.markdown();
        let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("| returns |")).collect();
        assert!(!rows.is_empty() && rows.iter().all(|row| !row.contains("never")), "{text}");
        let columns = |line: &str| line.matches('|').count();
        assert!(
            rows.iter().all(|row| text
                .lines()
                .any(|line| line.starts_with("| method") && columns(line) == columns(row))),
            "{text}"
        );
    }

    #[test]
    fn causes_are_shares_of_all_episodes() {
        let told = vec![evaluated(1, 0.5, &[("ab", 5)]), evaluated(2, 0.5, &[("ab", 7)])];
        let silent = vec![evaluated(1, 0.5, &[]), run(2, &[(100.0, 0.25)])];
        let comparison = Comparison::of("t", &[group("x", told), group("y", silent)]);
        let [cause] = &comparison.causes[..] else { panic!("{:?}", comparison.causes) };
        assert_eq!((cause.cause.as_str(), cause.label.as_str()), ("burned_late", "x"));
        assert_eq!(cause.share.mean, 0.1);
    }

    #[test]
    fn teams_are_compared_by_size_then_letters() {
        let first =
            vec![evaluated(1, 0.5, &[("ab", 5), ("b", 10)]), evaluated(2, 0.5, &[("ab", 7)])];
        let second = vec![evaluated(1, 0.5, &[("ab", 2), ("aa", 0)])];
        let comparison = Comparison::of("t", &[group("x", first), group("y", second)]);
        let teams: Vec<_> = comparison
            .teams
            .iter()
            .map(|team| (team.team.as_str(), team.label.as_str(), team.episodes, team.success.mean))
            .collect();
        assert_eq!(
            teams,
            [("b", "x", 10, 1.0), ("aa", "y", 10, 0.0), ("ab", "x", 20, 0.6), ("ab", "y", 10, 0.2)]
        );
    }
}
