//! Solvers of others, beside what was learned: what Python has of them.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use serde::{Deserialize, Serialize};
use sortie_bundle::files::{MOST_TEXT_BYTES, read_text};

use crate::failure::{Exit, Failure};
use crate::files::write_output;
use crate::output::{Common, tell};

/// What measures them. It is given to Python as its input, so that the program needs no file beside it.
const SCRIPT: &str = include_str!("../../../benches/routes.py");

/// What a solver came to.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Solver {
    pub(super) solver: String,
    pub(super) over_optimum: f64,
    /// Half of the interval that has the mean of all instances in 95 of 100 cases.
    pub(super) ci95: f64,
    /// The median of all instances.
    pub(super) milliseconds: f64,
    pub(super) unsolved: usize,
}

/// What solvers came to by these words of the script, measured where `solvers.json` does not have it yet. None where Python lacks them, which is
/// said and does not last.
pub(super) fn beside(words: &str, folder: &Path, common: Common) -> Result<Vec<Solver>, Failure> {
    if words.is_empty() {
        return Ok(Vec::new());
    }
    let file = folder.join("solvers.json");
    let lines = if file.exists() {
        read_text(&file, MOST_TEXT_BYTES).map_err(|error| Failure::file(&file, &error))?
    } else {
        measured(words, common)
    };
    let solvers = serde_json::Deserializer::from_str(&lines).into_iter();
    let solvers = solvers.collect::<Result<Vec<Solver>, _>>().map_err(|error| {
        Failure::new(Exit::BadData, format!("{}: {error}; remove it", file.display()))
    })?;
    if !solvers.is_empty() {
        write_output(&file, lines.as_bytes())?;
    }
    Ok(solvers)
}

/// What the script prints, a line a solver; nothing where it ends otherwise than well.
fn measured(words: &str, common: Common) -> String {
    if !common.quiet {
        tell!("solvers beside it: python3 benches/routes.py {words}");
    }
    let lines = printed(words);
    if lines.is_none() && !common.quiet {
        tell!("no solvers beside it: python3 with numpy, ortools and pyvrp has them");
    }
    lines.unwrap_or_default()
}

fn printed(words: &str) -> Option<String> {
    let mut python = Command::new("python3")
        .arg("-")
        .args(words.split_whitespace())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    // Dropped at the end of the line, or Python would wait for more of its program.
    python.stdin.take()?.write_all(SCRIPT.as_bytes()).ok()?;
    let ended = python.wait_with_output().ok()?;
    ended.status.success().then(|| String::from_utf8(ended.stdout).ok()).flatten()
}
