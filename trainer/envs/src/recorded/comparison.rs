//! Compares what a file says with what a replay gives.

use serde::Serialize;
use serde_json::Value;

use super::error::GoldenError;
use super::fields::Field;

/// One value that came out differently.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mismatch {
    /// The file, as it was named.
    pub file: String,
    /// The step, or the state before that step; masks of the whole episode count as step 0, its
    /// events as the last state.
    pub step: usize,
    /// Path of the field in the file.
    pub field: String,
    /// What the file says.
    pub want: Value,
    /// What the replay gives; null where it gives nothing.
    pub got: Value,
}

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Replay {
    /// The steps that were replayed.
    pub steps: usize,
    /// All differences, in the order of the episode.
    pub mismatches: Vec<Mismatch>,
}

/// Collects the differences of one file.
pub(crate) struct Comparison<'a> {
    file: &'a str,
    /// The step that is compared, or the state before it.
    pub(crate) step: usize,
    mismatches: Vec<Mismatch>,
}

impl<'a> Comparison<'a> {
    /// Nothing compared yet; `file` names the file in the mismatches.
    pub(crate) fn new(file: &'a str) -> Self {
        Self { file, step: 0, mismatches: Vec::new() }
    }

    /// What was found after so many steps.
    pub(crate) fn finish(self, steps: usize) -> Replay {
        Replay { steps, mismatches: self.mismatches }
    }

    /// Compares a value with what the replay gives, down to single numbers.
    ///
    /// Collisions, features and final values differ in what they list, so they are compared as one.
    pub(crate) fn compare(&mut self, want: &Field<'_>, got: &Value) -> Result<(), GoldenError> {
        match got {
            Value::Object(members) => {
                for (name, got) in members {
                    if matches!(name.as_str(), "bounces" | "feat" | "info") {
                        self.compare_whole(&want.get(name)?, got);
                    } else {
                        self.compare(&want.get(name)?, got)?;
                    }
                }
            }
            Value::Array(items) => {
                for (want, got) in want.exactly(items.len())?.iter().zip(items) {
                    self.compare(want, got)?;
                }
            }
            Value::Bool(_) => {
                want.flag()?;
                self.compare_whole(want, got);
            }
            _ => {
                want.number()?;
                self.compare_whole(want, got);
            }
        }
        Ok(())
    }

    /// Compares a value as one.
    pub(crate) fn compare_whole(&mut self, want: &Field<'_>, got: &Value) {
        if !same(want.value(), got) {
            self.note(want.path(), want.value(), got);
        }
    }

    /// Adds a difference.
    pub(crate) fn note(&mut self, field: &str, want: &Value, got: &Value) {
        self.mismatches.push(Mismatch {
            file: self.file.into(),
            step: self.step,
            field: field.into(),
            want: want.clone(),
            got: got.clone(),
        });
    }
}

/// Equality in which an integer equals the float of the same value, and floats are equal bit for bit.
fn same(one: &Value, other: &Value) -> bool {
    match (one, other) {
        (Value::Number(one), Value::Number(other)) => {
            one.as_f64().map(f64::to_bits) == other.as_f64().map(f64::to_bits)
        }
        (Value::Array(one), Value::Array(other)) => {
            one.len() == other.len() && one.iter().zip(other).all(|(one, other)| same(one, other))
        }
        (Value::Object(one), Value::Object(other)) => {
            one.len() == other.len()
                && one.iter().all(|(name, one)| other.get(name).is_some_and(|it| same(one, it)))
        }
        _ => one == other,
    }
}
