//! One run per seed, and what all of them came to.

use std::path::Path;

use serde::Serialize;
use sortie_ipc::Stop;
use sortie_learn::evaluate::Score;
use sortie_learn::report::Spread;
use sortie_learn::run::Setup;

use super::sweep::{Finished, Sweep, learn_all, suffixed};
use crate::failure::{Exit, Failure, Outcome};
use crate::options::Common;
use crate::output::{Table, print_json};
use crate::seeds::SeedRange;

/// What all seeds together came to.
#[derive(Clone, Debug, Serialize)]
struct Summary {
    seeds: usize,
    success_mean: f64,
    success_sd: f64,
    success_min: f64,
    success_max: f64,
    return_mean: f64,
    return_sd: f64,
    runs: Vec<Finished>,
}

/// Runs all seeds; those that are finished already are only read. A seed that fails stops no other.
pub(super) fn run(
    seeds: SeedRange,
    setup: &Setup,
    threads: usize,
    out: &Path,
    common: Common,
    stop: &Stop,
) -> Outcome {
    if setup.run.final_episodes == 0 {
        let reason = "`run.final_episodes` is 0: a sweep compares what its seeds report in the end";
        return Err(Failure::new(Exit::Usage, reason));
    }
    let configuration = suffixed(out, ".toml");
    let sweep = Sweep::new(setup, threads, [out, &configuration], common);
    for seed in seeds.iter() {
        sweep.check(seed)?;
    }
    sweep.write_configuration()?;
    let jobs: Vec<_> = seeds.iter().map(|seed| (&sweep, seed)).collect();
    let runs = learn_all(&jobs, threads, stop, || ())?;
    print(&Summary::new(runs), Score::of_environment(&setup.environment.to_string()), common);
    Ok(())
}

/// Mean and spread of what finished runs report.
fn spread(runs: &[Finished], figure: fn(&Finished) -> f64) -> Spread {
    let nothing = Spread { mean: f64::NAN, sd: None, min: f64::NAN, max: f64::NAN };
    Spread::of(runs.iter().map(figure)).unwrap_or(nothing)
}

impl Summary {
    fn new(runs: Vec<Finished>) -> Self {
        let success = spread(&runs, |run| run.success);
        let returned = spread(&runs, |run| run.return_mean);
        Self {
            seeds: runs.len(),
            success_mean: success.mean,
            success_sd: success.sd.unwrap_or(0.0),
            success_min: success.min,
            success_max: success.max,
            return_mean: returned.mean,
            return_sd: returned.sd.unwrap_or(0.0),
            runs,
        }
    }
}

fn print(summary: &Summary, score: Score, common: Common) {
    if common.json {
        print_json(summary);
        return;
    }
    let figure: fn(&Finished) -> f64 = match score {
        Score::Success => |run| run.success,
        Score::Return => |run| run.return_mean,
    };
    let mut table = Table::new(&["run", score.name()]);
    for run in &summary.runs {
        table.row([run.run.display().to_string(), score.text(figure(run))]);
    }
    let Spread { mean, sd, min, max } = spread(&summary.runs, figure);
    let [mean, sd, min, max] = [mean, sd.unwrap_or(0.0), min, max].map(|value| score.text(value));
    table.row(["mean".to_owned(), mean]);
    table.row(["standard deviation".to_owned(), sd]);
    table.row(["range".to_owned(), format!("{min} to {max}")]);
    table.print();
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    #[test]
    fn a_summary_tells_mean_and_spread() {
        let run = |seed, success| {
            let return_mean = 10.0 * success;
            Finished { seed, run: PathBuf::new(), success, return_mean }
        };
        let summary = Summary::new(vec![run(1, 0.5), run(2, 0.7), run(3, 0.9)]);
        assert!((summary.success_mean - 0.7).abs() < 1e-12);
        assert!((summary.success_sd - 0.2).abs() < 1e-12);
        assert_eq!((summary.success_min, summary.success_max), (0.5, 0.9));
        assert!((summary.return_mean - 7.0).abs() < 1e-12);
        assert!((summary.return_sd - 2.0).abs() < 1e-12);
    }
}
