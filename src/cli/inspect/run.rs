//! The facts of a training run: how it learns, its last evaluations, its curve.

use std::path::Path;

use console::Term;
use serde::Serialize;
use sortie_learn::evaluate::Score;
use sortie_learn::report::numbers::{count, duration};
use sortie_learn::report::{FinalResult, Row, RunRecord};
use sortie_learn::run::read_description;

use crate::failure::{Failure, Outcome};
use crate::output::{Table, print_json, say, wrapped};
use crate::terminal::{line_width, terminal_curve};

/// Evaluations that the table shows.
const SHOWN: usize = 8;
const CURVE_HEIGHT: usize = 11;

#[derive(Serialize)]
struct RunFacts<'a> {
    run: String,
    seed: Option<u64>,
    environment: &'a Option<String>,
    configuration: &'a toml::Table,
    curve: &'a [Row],
    result: &'a Option<FinalResult>,
}

pub(super) fn inspect(folder: &Path, json: bool) -> Outcome {
    if !RunRecord::is_in(folder) {
        return inspect_beginning(folder, json);
    }
    let run = RunRecord::open(folder)?;
    if json {
        print_json(&RunFacts {
            run: folder.display().to_string(),
            seed: run.seed,
            environment: &run.environment,
            configuration: &run.description,
            curve: &run.rows,
            result: &run.result,
        });
        return Ok(());
    }
    print_configuration(&run);
    say!();
    print_evaluations(&run);
    say!();
    let points: Vec<(f64, f64)> =
        run.curve.iter().map(|point| (point.env_steps, point.of(run.score))).collect();
    let width = usize::from(Term::stdout().size().1);
    for line in terminal_curve(&points, run.score, width, CURVE_HEIGHT) {
        say!("{line}");
    }
    print_result(&run);
    Ok(())
}

/// The same of a run that has not been evaluated yet.
fn inspect_beginning(folder: &Path, json: bool) -> Outcome {
    let description = read_description(folder)?;
    let text = description.to_toml()?;
    let configuration: toml::Table = text.parse().map_err(Failure::bug)?;
    let environment = Some(description.config.environment.to_string());
    if json {
        print_json(&RunFacts {
            run: folder.display().to_string(),
            seed: Some(description.seed),
            environment: &environment,
            configuration: &configuration,
            curve: &[],
            result: &None,
        });
        return Ok(());
    }
    say!("run {}", folder.display());
    print_section("", &configuration);
    say!("\nnot evaluated yet");
    Ok(())
}

/// The configuration as `--set` takes it, a section after the other.
fn print_configuration(run: &RunRecord) {
    say!("run {}", run.name());
    print_section("", &run.description);
}

fn print_section(prefix: &str, section: &toml::Table) {
    let values = section.iter().filter(|(_, value)| !value.is_table());
    let values = values.map(|(key, value)| format!("{prefix}{key}={}", plain(value)));
    for line in wrapped(values, line_width()) {
        say!("{line}");
    }
    for (name, inner) in section.iter().filter_map(|(name, value)| Some((name, value.as_table()?)))
    {
        print_section(&format!("{prefix}{name}."), inner);
    }
}

/// A value without the quotes of a text.
fn plain(value: &toml::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn print_evaluations(run: &RunRecord) {
    let hidden = run.rows.len().saturating_sub(SHOWN);
    let figures: &[&str] = match run.score {
        Score::Success => &["success", "95 % interval", "time-outs"],
        Score::Return => &["return"],
    };
    let mut table = Table::new(&[&["steps", "wall", "CPU"], figures, &["loss"]].concat());
    for (row, point) in run.rows.iter().zip(&run.curve).skip(hidden) {
        let number = |name: &str, places: usize| {
            row.number(name).map_or(String::new(), |value| format!("{value:.places$}"))
        };
        let (low, high) = (number("success_ci95_low", 3), number("success_ci95_high", 3));
        let interval = [format!("{low} to {high}"), number("timeouts", 3)];
        let rest = if run.score == Score::Success { &interval[..] } else { &[] };
        let times = [count(point.env_steps), duration(point.wall_s), duration(point.cpu_s)];
        let score = run.score.text(point.of(run.score));
        table.row(times.into_iter().chain([score]).chain(rest.to_vec()).chain([number("loss", 4)]));
    }
    table.print();
    if hidden > 0 {
        say!("and {hidden} evaluations before");
    }
}

fn print_result(run: &RunRecord) {
    let Some(result) = &run.result else { return };
    let allocation = result.allocation.as_deref().unwrap_or("unknown");
    let (name, score, episodes) =
        (run.score.name(), run.score.text(run.final_score()), result.episodes);
    say!(
        "\nfinal evaluation: {name} {score} of {episodes} fresh episodes, {allocation} allocation"
    );
}
