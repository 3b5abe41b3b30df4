//! An evaluation as tables.

use sortie_envs::Metric;
use sortie_learn::evaluate::Evaluation;

use super::BySeed;
use crate::output::{Table, plural, say};

pub(super) fn print(evaluation: &Evaluation, metrics: &[Metric], by_seed: Option<&BySeed>) {
    let [low, high] = evaluation.success_ci95;
    let mut table = Table::new(&["figure", "value"]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("success", format!("{:.3} ({low:.3} to {high:.3})", evaluation.success));
    if let Some(BySeed { success, success_sd }) = by_seed {
        let least = success.values().copied().fold(f64::INFINITY, f64::min);
        let most = success.values().copied().fold(0.0, f64::max);
        let name = format!("of {}", plural(success.len(), "seed"));
        row(&name, format!("sd {success_sd:.3} ({least:.3} to {most:.3})"));
    }
    for metric in metrics {
        if let Some(value) = evaluation.metrics.get(metric.name) {
            row(metric.about, format!("{value:.3}"));
        }
    }
    row("time-outs", format!("{:.3}", evaluation.timeouts));
    row("return", format!("{:.2} (sd {:.2})", evaluation.return_mean, evaluation.return_sd));
    row("steps", format!("{:.1}", evaluation.length_mean));
    table.print();
    say!();
    if !evaluation.failures.is_empty() {
        print_failures(evaluation);
        say!();
    }
    let mut teams = Table::new(&["team", "episodes", "success"]);
    for (team, success) in &evaluation.by_team {
        let share = success.solved as f64 / success.episodes.max(1) as f64;
        teams.row([team.clone(), success.episodes.to_string(), format!("{share:.3}")]);
    }
    teams.print();
}

fn print_failures(evaluation: &Evaluation) {
    let mut causes = Table::new(&["cause of failure", "episodes", "share"]);
    for (cause, count) in &evaluation.failures {
        let share = *count as f64 / evaluation.episodes.max(1) as f64;
        causes.row([cause.clone(), count.to_string(), format!("{share:.3}")]);
    }
    causes.print();
}
