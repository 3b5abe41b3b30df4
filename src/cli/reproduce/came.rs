//! What the runs of a figure came to, beside the dissertation.

use std::path::Path;

use serde::Serialize;
use sortie_learn::report::{RunRecord, Spread};

use super::recipe::Measure;
use crate::failure::{Exit, Failure};

/// A figure's numbers.
#[derive(Debug, Serialize)]
pub(super) struct Came<'a> {
    pub(super) figure: &'a str,
    pub(super) about: &'a str,
    pub(super) why: &'a str,
    pub(super) seeds: &'a [u64],
    pub(super) rows: Vec<Row<'a>>,
    /// Processor time of all runs, their evaluations while learning included.
    pub(super) cpu_s: f64,
}

/// A method in a case.
#[derive(Debug, Serialize)]
pub(super) struct Row<'a> {
    pub(super) case: &'a str,
    pub(super) method: &'a str,
    /// What `sortie train` was told.
    pub(super) command: String,
    pub(super) measures: Vec<Measured<'a>>,
    /// What the dissertation says.
    pub(super) published: Option<&'a str>,
    pub(super) cpu_s: Spread,
}

/// A number over the seeds.
#[derive(Debug, Serialize)]
pub(super) struct Measured<'a> {
    pub(super) name: &'a str,
    pub(super) seeds: Vec<f64>,
    #[serde(flatten)]
    pub(super) spread: Spread,
    #[serde(skip)]
    pub(super) digits: usize,
}

impl Measured<'_> {
    /// `1.99 ± 0.01 (1.97 to 2.00)`
    pub(super) fn text(&self) -> String {
        let (Spread { mean, sd, min, max }, digits) = (self.spread, self.digits);
        match sd {
            Some(sd) => {
                format!("{mean:.digits$} ± {sd:.digits$} ({min:.digits$} to {max:.digits$})")
            }
            None => format!("{mean:.digits$}"),
        }
    }
}

impl<'a> Measured<'a> {
    /// A number of runs that have ended.
    pub(super) fn of(measure: &'a Measure, runs: &[RunRecord]) -> Result<Self, Failure> {
        let value = |run| Ok(measure.factor * number(run, &measure.key)?);
        let seeds = runs.iter().map(value).collect::<Result<Vec<f64>, Failure>>()?;
        let none = || Failure::new(Exit::Bug, "a row without runs; please report this");
        let spread = Spread::of(seeds.iter().copied()).ok_or_else(none)?;
        Ok(Self { name: &measure.name, seeds, spread, digits: measure.digits })
    }
}

/// A number of a run: of its last point where it tells of training, else of its final evaluation.
fn number(run: &RunRecord, key: &str) -> Result<f64, Failure> {
    let found = if key.starts_with("training_") {
        run.rows.last().and_then(|row| row.number(key))
    } else {
        run.result.as_ref().and_then(|result| match key {
            "success" => Some(result.success),
            "return_mean" => result.return_mean,
            "length_mean" => result.length_mean,
            _ => result.metrics().find(|(name, _)| *name == key).map(|(_, value)| value),
        })
    };
    found.ok_or_else(|| missing(&run.folder, key))
}

fn missing(folder: &Path, key: &str) -> Failure {
    let reason = format!("{}: no `{key}` in its files", folder.display());
    Failure::new(Exit::BadData, format!("{reason}: learn it again, or correct the recipe"))
}

impl Came<'_> {
    /// A document: the table, what a reader must know, and the command of every row.
    pub(super) fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}\n\n", self.figure, self.about);
        let names = self.rows.first().map_or(&[][..], |row| &row.measures[..]);
        let names: Vec<&str> = names.iter().map(|measure| measure.name).collect();
        text += &format!("| case | method | {} | CPU s a run | published |\n", names.join(" | "));
        text += &format!("{}|\n", "| --- ".repeat(names.len() + 4));
        for row in &self.rows {
            let measures: Vec<String> = row.measures.iter().map(Measured::text).collect();
            let (seconds, published) = (row.cpu_s.mean, row.published.unwrap_or_default());
            let measures = measures.join(" | ");
            let [case, method] = [row.case, row.method];
            text += &format!("| {case} | {method} | {measures} | {seconds:.2} | {published} |\n");
        }
        let (first, last) = (self.seeds.first(), self.seeds.last());
        let [first, last] = [first, last].map(|seed| seed.copied().unwrap_or_default());
        text += &format!(
            "\nMean ± standard deviation over the seeds {first} to {last}, and their range in brackets; {:.0} seconds of processor time. {}\n\n",
            self.cpu_s, self.why
        );
        text += "```sh\n";
        for row in &self.rows {
            text += &format!("sortie train {}\n", row.command);
        }
        text + "```\n"
    }
}
