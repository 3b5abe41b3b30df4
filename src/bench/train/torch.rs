//! The same update in PyTorch, in a process of its own.

use std::env;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::batch::{self, Expected};
use super::learning::Learning;
use crate::failure::{Exit, Failure};

const PROGRAM: &str = include_str!("../../../benches/train_step.py");
/// Largest relative difference at which two updates count as the same.
const TOLERANCE: f64 = 1e-3;

/// A running program that waits for its turn.
pub(super) struct Torch {
    process: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
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

/// What the program says once it is ready.
#[derive(Deserialize)]
struct Ready {
    torch: String,
    padded: Comparison,
    packed: Comparison,
}

/// The first batch in PyTorch.
#[derive(Deserialize)]
struct Comparison {
    loss: f64,
    gradient_norm: f64,
    gradient_error: f64,
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
        let folder =
            tempfile::tempdir().map_err(|error| Failure::file(&env::temp_dir(), &error))?;
        let data = folder.path().join("updates.safetensors");
        let program = folder.path().join("train_step.py");
        fs::write(&program, PROGRAM).map_err(|error| Failure::file(&program, &error))?;
        let expected = batch::write(learning, &data)?;
        let mut process = Command::new(python)
            .args([&program, &data])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| Failure::file(python, &error))?;
        let (Some(input), Some(output)) = (process.stdin.take(), process.stdout.take()) else {
            return Err(Failure::new(Exit::Bug, "the PyTorch program has no pipes"));
        };
        let mut torch =
            Self { process, input, output: BufReader::new(output), version: String::new() };
        let ready: Ready = torch.read()?;
        for (formulation, found) in Formulation::ALL.iter().zip([&ready.padded, &ready.packed]) {
            check(found, &expected)?;
            if !quiet {
                let Comparison { loss, gradient_norm, gradient_error } = found;
                eprintln!(
                    "note: {} computes the same update: loss {loss:.6} (ours {:.6}), gradient norm \
                     {gradient_norm:.6} (ours {:.6}), relative distance of the gradients {gradient_error:.1e}",
                    formulation.engine(),
                    expected.loss,
                    expected.gradient_norm,
                );
            }
        }
        torch.version = ready.torch;
        Ok(torch)
    }

    /// Version of torch.
    pub(super) fn version(&self) -> &str {
        &self.version
    }

    /// Updates for so many CPU-seconds; returns updates per CPU-second.
    pub(super) fn turn(&mut self, how: Formulation, seconds: f64) -> Result<f64, Failure> {
        writeln!(self.input, "{} {seconds}", how.name()).map_err(ended)?;
        let turn: Turn = self.read()?;
        Ok(turn.updates / turn.cpu_s)
    }

    fn read<T: DeserializeOwned>(&mut self) -> Result<T, Failure> {
        let mut line = String::new();
        self.output.read_line(&mut line).map_err(ended)?;
        serde_json::from_str(&line).map_err(ended)
    }
}

/// The program is gone; what went wrong stands on its standard error.
fn ended(error: impl Into<std::io::Error>) -> Failure {
    Failure::new(Exit::NotRunning, format!("the PyTorch program stopped: {}", error.into()))
}

impl Drop for Torch {
    fn drop(&mut self) {
        // It may have ended already; either way it is gone then.
        let _ = self.process.kill();
        let _ = self.process.wait();
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
        eprintln!("note: {message}; only our figures follow (name another with --python)");
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

/// Refuses to compare different things.
fn check(found: &Comparison, expected: &Expected) -> Result<(), Failure> {
    let differs = |got: f64, want: f64| (got - want).abs() > TOLERANCE * want.abs();
    if found.gradient_error > TOLERANCE
        || differs(found.loss, expected.loss)
        || differs(found.gradient_norm, expected.gradient_norm)
    {
        return Err(Failure::difference(format!(
            "PyTorch computes another update: loss {} against ours {}, gradient norm {} against {}, \
             relative distance {}",
            found.loss,
            expected.loss,
            found.gradient_norm,
            expected.gradient_norm,
            found.gradient_error
        )));
    }
    Ok(())
}
