//! The same update in PyTorch.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Deserialize;

use super::batch;
use super::learning::Learning;
use super::program::{Comparison, Expected, Program};
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::output::tell;

const PROGRAM: &str = include_str!("../../../../benches/train_step.py");

/// A running program that waits for its turn.
pub(super) struct Torch {
    program: Program,
    version: String,
}

/// How a batch of teams of different sizes becomes tensors.
#[derive(Clone, Copy)]
pub(super) enum Formulation {
    /// Every team as large as the largest.
    Padded,
    /// All agents in one list, attention by indices.
    Packed,
}

impl Formulation {
    pub(super) const ALL: [Self; 2] = [Self::Padded, Self::Packed];

    /// Its name as a peer.
    pub(super) fn engine(self) -> &'static str {
        match self {
            Self::Padded => "pytorch, padded",
            Self::Packed => "pytorch, packed",
        }
    }

    /// Its name in the program.
    fn name(self) -> &'static str {
        match self {
            Self::Padded => "padded",
            Self::Packed => "packed",
        }
    }
}

/// What the program says once it is ready: the first batch in PyTorch.
#[derive(Deserialize)]
struct Ready {
    torch: String,
    padded: Comparison,
    packed: Comparison,
}

#[derive(Deserialize)]
struct Turn {
    updates: f64,
    cpu_s: f64,
}

impl Torch {
    /// Starts the program and compares one update with ours.
    pub(super) fn start(
        python: &Path,
        learning: &mut Learning,
        quiet: bool,
    ) -> Result<Self, Failure> {
        let mut expected = Expected { loss: f64::NAN, gradient_norm: f64::NAN };
        let write = |path: &Path| batch::write(learning, path).map(|found| expected = found);
        let (program, ready) = Program::start::<Ready>(python, PROGRAM, &[], write)?;
        for (formulation, found) in Formulation::ALL.iter().zip([&ready.padded, &ready.packed]) {
            found.check((formulation.engine(), "the agents"), expected, quiet)?;
        }
        Ok(Self { program, version: ready.torch })
    }

    /// Version of torch.
    pub(super) fn version(&self) -> &str {
        &self.version
    }

    /// Updates for so many CPU-seconds; returns updates per CPU-second.
    pub(super) fn turn(&mut self, how: Formulation, seconds: f64) -> Result<f64, Failure> {
        let turn: Turn = self.program.ask(&format!("{} {seconds}", how.name()))?;
        Ok(turn.updates / turn.cpu_s)
    }
}

/// The Python that has torch, or a note that there is none.
pub(super) fn find(asked: Option<&Path>, quiet: bool) -> Result<Option<PathBuf>, Failure> {
    let python = asked.map_or_else(default_python, Path::to_path_buf);
    if has_torch(&python) {
        return Ok(Some(python));
    }
    let message = format!("`{}` has no torch", python.display());
    if asked.is_some() {
        return Err(Failure::new(Exit::NotRunning, message));
    }
    if !quiet {
        tell!("note: {message}; only our figures follow (name another with --python)");
    }
    Ok(None)
}

fn default_python() -> PathBuf {
    match env::var_os("VIRTUAL_ENV") {
        Some(folder) => Path::new(&folder).join("bin/python3"),
        None => PathBuf::from("python3"),
    }
}

fn has_torch(python: &Path) -> bool {
    let mut command = Command::new(python);
    command.args(["-c", "import torch"]).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}
