//! What a run depends on, named once: the same function writes it to a checkpoint and reads it back.

use std::collections::BTreeMap;

use serde::Serialize;
use serde::de::DeserializeOwned;
pub use sortie_nn::tape::Tensor;

use crate::error::{LearnError, Result};
use crate::run::checkpoint::{Checkpoint, Written, in_bytes};

/// Visits everything that a run depends on.
#[derive(Debug)]
pub struct State<'a>(Visit<'a>);

#[derive(Debug)]
enum Visit<'a> {
    Write(&'a mut Written),
    /// As `Write`, of what is needed to use what was learned.
    WriteKept(&'a mut Written),
    Read {
        checkpoint: &'a Checkpoint,
        values: &'a BTreeMap<String, Vec<u8>>,
    },
    Weights(&'a Checkpoint),
}

impl<'a> State<'a> {
    /// A visit that writes down what it finds.
    pub(crate) fn write(written: &'a mut Written) -> Self {
        Self(Visit::Write(written))
    }

    /// A visit that writes down what is needed to use what was learned, and no more: no replay, which is most of a run.
    pub(crate) fn write_kept(written: &'a mut Written) -> Self {
        Self(Visit::WriteKept(written))
    }

    /// A visit that puts everything back as a checkpoint has it.
    pub(crate) fn read(checkpoint: &'a Checkpoint, values: &'a BTreeMap<String, Vec<u8>>) -> Self {
        Self(Visit::Read { checkpoint, values })
    }

    /// A visit that puts back tensors only: enough to use what was learned.
    pub(crate) fn weights(checkpoint: &'a Checkpoint) -> Self {
        Self(Visit::Weights(checkpoint))
    }

    /// A vector of parameters, cut into its tensors; `name` as in `agents/online`.
    ///
    /// # Errors
    /// The checkpoint has other tensors.
    pub fn tensors(
        &mut self,
        name: &str,
        tensors: &[Tensor],
        parameters: &mut [f32],
    ) -> Result<()> {
        for tensor in tensors {
            // A vector that is kept whole is one tensor without a name of its own.
            let end =
                if tensor.name.is_empty() { String::new() } else { format!("/{}", tensor.name) };
            let (name, part) = (format!("{name}{end}"), &mut parameters[tensor.range.clone()]);
            match &mut self.0 {
                Visit::Write(written) | Visit::WriteKept(written) => {
                    written.tensors.push((name, tensor.shape.clone(), in_bytes(part)));
                }
                Visit::Read { checkpoint, .. } | Visit::Weights(checkpoint) => {
                    part.copy_from_slice(&checkpoint.whole_vector(&name, part.len())?);
                }
            }
        }
        Ok(())
    }

    /// A vector of parameters that is kept whole.
    ///
    /// # Errors
    /// The checkpoint has none, or another.
    pub fn vector(&mut self, name: &str, parameters: &mut [f32]) -> Result<()> {
        let range = 0..parameters.len();
        let whole = Tensor { name: String::new(), shape: vec![1, range.end], range };
        self.tensors(name, &[whole], parameters)
    }

    /// Anything else; visits that want weights only pass it over.
    ///
    /// # Errors
    /// The checkpoint has no such value, or one of another kind.
    pub fn value<T: Serialize + DeserializeOwned>(
        &mut self,
        name: &str,
        value: &mut T,
    ) -> Result<()> {
        match &mut self.0 {
            Visit::Write(written) => {
                let bytes = postcard::to_stdvec(value);
                let bytes = bytes.map_err(|error| unfit(name, &error))?;
                written.values.insert(name.to_owned(), bytes);
            }
            Visit::Read { values, .. } => {
                let bytes = values.get(name).ok_or_else(|| {
                    unfit(name, &"is missing: another version of Sortie wrote it")
                })?;
                *value = postcard::from_bytes(bytes).map_err(|error| unfit(name, &error))?;
            }
            Visit::Weights(_) | Visit::WriteKept(_) => {}
        }
        Ok(())
    }

    /// The same of what checkpoints of earlier versions lack: it stays as it is then.
    pub(crate) fn later<T: Serialize + DeserializeOwned>(
        &mut self,
        name: &str,
        value: &mut T,
    ) -> Result<()> {
        match &self.0 {
            Visit::Read { values, .. } if !values.contains_key(name) => Ok(()),
            _ => self.value(name, value),
        }
    }

    /// The same of what is needed to use what was learned, beside tensors.
    ///
    /// # Errors
    /// The checkpoint has no such value, or one of another kind.
    pub fn kept<T: Serialize + DeserializeOwned>(
        &mut self,
        name: &str,
        value: &mut T,
    ) -> Result<()> {
        match &mut self.0 {
            Visit::Weights(checkpoint) => {
                State::read(checkpoint, &checkpoint.state()?).value(name, value)
            }
            Visit::WriteKept(written) => State::write(written).value(name, value),
            _ => self.value(name, value),
        }
    }

    /// Whether this visit wants what was learned and nothing else.
    pub fn wants_weights(&self) -> bool {
        matches!(self.0, Visit::Weights(_))
    }

    /// Whether this visit changes what it visits.
    pub fn is_reading(&self) -> bool {
        !matches!(self.0, Visit::Write(_) | Visit::WriteKept(_))
    }
}

fn unfit(name: &str, reason: &dyn std::fmt::Display) -> LearnError {
    LearnError::Config(format!("`{name}` of the checkpoint: {reason}"))
}
