//! Guards of a policy in words, and what they did while it was served.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use sortie_bundle::files::{MOST_TEXT_BYTES, read_file};
use sortie_core::plan::{
    Beyond, GuardFacts, GuardedBy, GuardedOutputs, InputGuards, OutputGuards, Trip,
};

use crate::failure::{Exit, Failure};
use crate::output::{Table, plural, tell};

/// Longer lists are counted, not shown.
const SHOWN: usize = 12;

/// Guards as somebody wrote them.
///
/// # Errors
/// The file cannot be read, is no TOML, or has a key that is none.
pub fn read_guards(path: &Path) -> Result<GuardFacts, Failure> {
    let text = read_file(path, MOST_TEXT_BYTES).map_err(|error| Failure::file(path, &error))?;
    let bad = |reason: String| Failure::new(Exit::BadData, reason).within(path.display());
    let text = String::from_utf8(text).map_err(|error| bad(error.to_string()))?;
    toml::from_str(&text).map_err(|error: toml::de::Error| bad(error.message().to_owned()))
}

/// What is guarded, by name, one a line.
pub(crate) fn lines(guards: &GuardFacts) -> Vec<(&'static str, String)> {
    let GuardFacts { hold, fallback, age_ms, inputs, outputs } = guards;
    let InputGuards { lowest, highest } = inputs;
    let mut lines = Vec::new();
    if !inputs.is_empty() {
        lines.push(("guarded_inputs", limits(&[("lowest", lowest), ("highest", highest)])));
    }
    let OutputGuards { lowest, highest, change, beyond } = outputs;
    if !outputs.is_empty() {
        let named = limits(&[("lowest", lowest), ("highest", highest), ("change", change)]);
        let beyond = match beyond {
            Beyond::Fallback => "else the fallback",
            Beyond::Clamp => "else clamped",
        };
        lines.push(("guarded_outputs", format!("{named}, {beyond}")));
    }
    if let Some(ms) = age_ms {
        lines.push(("guarded_age", format!("at most {ms} ms")));
    }
    let fallback = match fallback {
        None => "the caller's".to_owned(),
        Some(GuardedOutputs::Named(GuardedBy::Hold)) => "hold".to_owned(),
        Some(GuardedOutputs::Named(GuardedBy::Zero)) => "zero".to_owned(),
        Some(GuardedOutputs::Numbers(numbers)) => list(numbers),
    };
    let held = plural(*hold as usize, "further decision");
    lines.push(("guard_fallback", format!("{fallback}, for {held}")));
    lines
}

fn limits(named: &[(&str, &Vec<f32>)]) -> String {
    let said = named.iter().filter(|(_, numbers)| !numbers.is_empty());
    let said: Vec<String> =
        said.map(|(name, numbers)| format!("{name} {}", list(numbers))).collect();
    said.join(", ")
}

fn list(numbers: &[f32]) -> String {
    match numbers {
        [one] => one.to_string(),
        _ if numbers.len() > SHOWN => plural(numbers.len(), "number"),
        _ => format!("{numbers:?}"),
    }
}

/// How often a guard tripped.
#[derive(Debug, Serialize)]
pub(crate) struct Tripped {
    guard: &'static str,
    /// Which input or output.
    #[serde(skip_serializing_if = "Option::is_none")]
    index: Option<u32>,
    observations: u64,
}

/// What guards did while a policy was served.
#[derive(Debug, Default)]
pub(crate) struct Trips(BTreeMap<Trip, u64>);

impl Trips {
    /// Counts one; the first of each guard is told at once, if anybody listens.
    pub(crate) fn count(&mut self, seq: u64, trip: Trip, is_told: bool) {
        let count = self.0.entry(trip).or_default();
        *count += 1;
        if *count == 1 && is_told && trip != Trip::Held {
            tell!("guard `{}` tripped at observation {seq}: {trip}", trip.name());
        }
    }

    /// All that tripped.
    pub(crate) fn tripped(&self) -> Vec<Tripped> {
        let each = |(trip, count): (&Trip, &u64)| Tripped {
            guard: trip.name(),
            index: trip.index(),
            observations: *count,
        };
        self.0.iter().map(each).collect()
    }

    /// A line for each.
    pub(crate) fn print(&self) {
        if self.0.is_empty() {
            return;
        }
        let mut table = Table::new(&["guard", "number", "observations"]);
        for Tripped { guard, index, observations } in self.tripped() {
            let index = index.map_or_else(String::new, |index| index.to_string());
            table.row([guard.to_owned(), index, observations.to_string()]);
        }
        table.print();
    }
}
