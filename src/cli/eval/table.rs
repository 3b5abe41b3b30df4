//! An evaluation as tables.

use sortie_envs::Spec;
use sortie_learn::evaluate::Evaluation;

use super::BySeed;
use crate::output::{Table, plural, say};

pub(super) fn print(evaluation: &Evaluation, spec: &Spec, by_seed: Option<&BySeed>) {
    let Evaluation { success, success_ci95: [low, high], return_mean, return_sd, .. } = evaluation;
    let mut table = Table::new(&["figure", "value"]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    let success = ("success", format!("{success:.3} ({low:.3} to {high:.3})"));
    let returned = ("return", format!("{return_mean:.2} (sd {return_sd:.2})"));
    let (first, by_seed) = match spec.has_success {
        true => (&success, by_seed.map(|by_seed| (&by_seed.success, by_seed.success_sd, 3))),
        false => (&returned, by_seed.map(|by_seed| (&by_seed.returns, by_seed.returns_sd, 2))),
    };
    row(first.0, first.1.clone());
    if let Some((of_seeds, sd, digits)) = by_seed {
        let least = of_seeds.values().copied().fold(f64::INFINITY, f64::min);
        let most = of_seeds.values().copied().fold(f64::NEG_INFINITY, f64::max);
        let name = format!("of {}", plural(of_seeds.len(), "seed"));
        row(&name, format!("sd {sd:.digits$} ({least:.digits$} to {most:.digits$})"));
    }
    for metric in spec.metrics {
        if let Some(value) = evaluation.metrics.get(metric.name) {
            row(metric.about, format!("{value:.3}"));
        }
    }
    if spec.has_success {
        row("time-outs", format!("{:.3}", evaluation.timeouts));
        row(returned.0, returned.1);
    }
    row("steps", format!("{:.1}", evaluation.length_mean));
    table.print();
    if !evaluation.failures.is_empty() {
        say!();
        print_failures(evaluation);
    }
    if spec.has_success {
        say!();
        print_teams(evaluation);
    }
}

fn print_teams(evaluation: &Evaluation) {
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
