//! The facts of a training run: how it learns, its last evaluations, its curve.

use std::path::Path;

use console::Term;
use serde::Serialize;
use sortie_learn::report::numbers::{count, duration};
use sortie_learn::report::{FinalResult, Row, RunRecord};

use crate::failure::Outcome;
use crate::output::{Table, print_json, say, wrapped};
use crate::terminal::line_width;
use crate::terminal_curve::terminal_curve;

/// Evaluations that the table shows.
const SHOWN: usize = 8;
/// Lines of the curve.
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
        run.curve().iter().map(|point| (point.env_steps, point.success)).collect();
    for line in terminal_curve(&points, usize::from(Term::stdout().size().1), CURVE_HEIGHT) {
        say!("{line}");
    }
    print_result(&run);
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
    let mut table =
        Table::new(&["steps", "wall", "CPU", "success", "95 % interval", "time-outs", "loss"]);
    for (row, point) in run.rows.iter().zip(run.curve()).skip(hidden) {
        let number = |name: &str, places: usize| {
            row.number(name).map_or(String::new(), |value| format!("{value:.places$}"))
        };
        table.row([
            count(point.env_steps),
            duration(point.wall_s),
            duration(point.cpu_s),
            format!("{:.3}", point.success),
            format!("{} to {}", number("success_ci95_low", 3), number("success_ci95_high", 3)),
            number("timeouts", 3),
            number("loss", 4),
        ]);
    }
    table.print();
    if hidden > 0 {
        say!("and {hidden} evaluations before");
    }
}

fn print_result(run: &RunRecord) {
    let Some(result) = &run.result else { return };
    let allocation = result.allocation.as_deref().unwrap_or("unknown");
    say!(
        "\nfinal evaluation: success {:.3} of {} fresh episodes, {allocation} allocation",
        result.success,
        result.episodes
    );
}
