//! A PyTorch program of ours in a process of its own: it says what it computes, then works in turns; and the tensors that it
//! reads.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::{env, fs};

use safetensors::tensor::{Dtype, TensorView};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::output::tell;

/// Largest relative difference at which two updates count as the same.
const TOLERANCE: f64 = 1e-3;

/// A running program that waits for its turn.
pub(super) struct Program {
    process: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Program {
    /// Starts a program on the data that `write` writes, beside modules by their file names, and reads what it says once
    /// it is ready.
    pub(super) fn start<T: DeserializeOwned>(
        python: &Path,
        source: &str,
        modules: &[(&str, &str)],
        write: impl FnOnce(&Path) -> Result<(), Failure>,
    ) -> Result<(Self, T), Failure> {
        let folder =
            tempfile::tempdir().map_err(|error| Failure::file(&env::temp_dir(), &error))?;
        let data = folder.path().join("data.safetensors");
        let program = folder.path().join("program.py");
        let put = |file: &Path, text: &str| {
            fs::write(file, text).map_err(|error| Failure::file(file, &error))
        };
        put(&program, source)?;
        for (name, text) in modules {
            put(&folder.path().join(name), text)?;
        }
        write(&data)?;
        let mut process = Command::new(python)
            .args([&program, &data])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| Failure::file(python, &error))?;
        let (Some(input), Some(output)) = (process.stdin.take(), process.stdout.take()) else {
            return Err(Failure::new(Exit::Bug, "the PyTorch program has no pipes"));
        };
        let mut program = Self { process, input, output: BufReader::new(output) };
        let ready = program.read()?;
        Ok((program, ready))
    }

    /// Says a line and reads the answer.
    pub(super) fn ask<T: DeserializeOwned>(&mut self, line: &str) -> Result<T, Failure> {
        writeln!(self.input, "{line}").map_err(ended)?;
        self.read()
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

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended already; either way it is gone then.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What our update finds.
#[derive(Clone, Copy)]
pub(super) struct Expected {
    pub(super) loss: f64,
    pub(super) gradient_norm: f64,
}

/// The same update in PyTorch.
#[derive(Deserialize)]
pub(super) struct Comparison {
    loss: f64,
    gradient_norm: f64,
    gradient_error: f64,
}

impl Comparison {
    /// Refuses to compare different things. `engine` computes the update of `what`.
    pub(super) fn check(
        &self,
        (engine, what): (&str, &str),
        expected: Expected,
        quiet: bool,
    ) -> Result<(), Failure> {
        let Self { loss, gradient_norm, gradient_error } = self;
        let found = format!(
            "loss {loss:.6} (ours {:.6}), gradient norm {gradient_norm:.6} (ours {:.6}), relative \
             distance of the gradients {gradient_error:.1e}",
            expected.loss, expected.gradient_norm,
        );
        let close = |got: f64, want: f64| (got - want).abs() <= TOLERANCE * want.abs();
        let same = *gradient_error <= TOLERANCE
            && close(*loss, expected.loss)
            && close(*gradient_norm, expected.gradient_norm);
        if !same {
            let message = format!("{engine} computes another update of {what}: {found}");
            return Err(Failure::difference(message));
        }
        if !quiet {
            tell!("note: {engine} computes the same update of {what}: {found}");
        }
        Ok(())
    }
}

/// Tensors by name, each with its kind, shape and bytes.
#[derive(Default)]
pub(super) struct Tensors(Vec<(String, Dtype, Vec<usize>, Vec<u8>)>);

impl Tensors {
    pub(super) fn floats(&mut self, name: String, shape: &[usize], values: &[f32]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.0.push((name, Dtype::F32, shape.to_vec(), bytes));
    }

    pub(super) fn integers(&mut self, name: String, shape: &[usize], values: &[i64]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.0.push((name, Dtype::I64, shape.to_vec(), bytes));
    }

    pub(super) fn flags(&mut self, name: String, shape: &[usize], values: &[bool]) {
        let bytes = values.iter().map(|value| u8::from(*value)).collect();
        self.0.push((name, Dtype::BOOL, shape.to_vec(), bytes));
    }

    /// Writes all of them, and numbers as the file's metadata.
    pub(super) fn write(
        &self,
        settings: HashMap<String, String>,
        path: &Path,
    ) -> Result<(), safetensors::SafeTensorError> {
        let mut views = Vec::new();
        for (name, dtype, shape, bytes) in &self.0 {
            views.push((name, TensorView::new(*dtype, shape.clone(), bytes)?));
        }
        safetensors::serialize_to_file(views, Some(settings), path)
    }
}

/// The gradient with the norm that it had before it was clipped.
pub(super) fn unclipped(gradient: &[f32], norm: f32) -> Vec<f32> {
    let now = gradient.iter().map(|slope| f64::from(*slope).powi(2)).sum::<f64>().sqrt();
    let factor = (f64::from(norm) / now.max(f64::MIN_POSITIVE)) as f32;
    gradient.iter().map(|slope| slope * factor).collect()
}
