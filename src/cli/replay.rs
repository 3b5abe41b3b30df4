//! `sortie replay`: does this build's environment agree with recorded episodes, bit for bit?

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use sortie_bundle::files::{MOST_BYTES, read_text};
use sortie_envs::golden::{self, GoldenError, Mismatch};

use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Common, plural, print_json, say};

/// Replay recorded episodes and compare every value bit for bit
///
/// Files follow the schema `sortie-golden/save-the-city/1` or `sortie-golden/group-matching/1`. This is
/// how a port of an environment is checked: record episodes there, replay them here. Exit code 1 if
/// anything differs.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  sortie replay tests/golden/save-the-city/*-scripted.json
  sortie eval runs/first --episodes-out episodes && sortie replay episodes")]
pub(crate) struct ReplayArguments {
    /// Recorded episodes, or folders of them
    #[arg(required = true, value_name = "FILE|DIR")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    files: usize,
    steps: usize,
    mismatches: Vec<Mismatch>,
}

pub(crate) fn run(arguments: &ReplayArguments) -> Outcome {
    let mut report = Report { files: 0, steps: 0, mismatches: Vec::new() };
    for path in &episodes(&arguments.files)? {
        let text = read_text(path, MOST_BYTES).map_err(|error| Failure::file(path, &error))?;
        let replay = golden::replay(&path.display().to_string(), &text)
            .map_err(|error| unreadable(error).within(path.display()))?;
        report.files += 1;
        report.steps += replay.steps;
        report.mismatches.extend(replay.mismatches);
    }
    if arguments.common.json {
        print_json(&report);
    } else {
        say!(
            "{}, {}: {}",
            plural(report.files, "file"),
            plural(report.steps, "step"),
            if report.mismatches.is_empty() { "all equal" } else { "DIFFERENT" }
        );
    }
    report
        .mismatches
        .first()
        .map_or(Ok(()), |first| Err(difference(first, report.mismatches.len())))
}

/// The files named, and in the place of a folder all recordings in it, as `sortie eval --episodes-out` writes them.
fn episodes(named: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in named {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let entries = path.read_dir().map_err(|error| Failure::file(path, &error))?;
        let entries = entries.flatten().map(|entry| entry.path());
        let mut found: Vec<PathBuf> =
            entries.filter(|path| path.extension().is_some_and(|end| end == "json")).collect();
        if found.is_empty() {
            let message = format!("{}: no recorded episode (`*.json`) in it", path.display());
            return Err(Failure::new(Exit::Missing, message));
        }
        found.sort();
        files.append(&mut found);
    }
    Ok(files)
}

/// The first of so many differences, as a failure.
pub(crate) fn difference(first: &Mismatch, count: usize) -> Failure {
    Failure::difference(format!(
        "{}: step {}: `{}` is {} in the file, {} here ({} in all)",
        first.file,
        first.step,
        first.field,
        first.want,
        first.got,
        plural(count, "difference"),
    ))
}

/// A recording that cannot be read, as a failure.
pub(crate) fn unreadable(error: GoldenError) -> Failure {
    let reason = std::error::Error::source(&error).map(|source| format!(": {source}"));
    Failure::new(Exit::BadData, format!("{error}{}", reason.unwrap_or_default()))
}
