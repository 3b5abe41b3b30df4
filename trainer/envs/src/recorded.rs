//! What recorded episodes of all environments have in common: how they are read, compared and recorded.

use std::fmt;
use std::ops::RangeInclusive;

use serde::Serialize;
use serde_json::Value;

use crate::environment::{Environment, Step};

/// What a recorded episode is called; for people, nothing depends on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Labels {
    /// Name of the episode.
    pub name: String,
    /// What the actions come from.
    pub policy: String,
    /// Seed of the run.
    pub seed: u64,
}

/// Writes one episode of one instance down.
///
/// Start it right after a reset, tell it every step, and take the text when the episode is done and
/// the instance not yet reset. It is told of the environment that it was started in, and of no other.
pub trait Record {
    /// Adds the step that was just taken.
    fn step(&mut self, environment: &dyn Environment, actions: &[u16], step: &Step);

    /// The episode as text.
    fn finish(self: Box<Self>, environment: &dyn Environment) -> String;
}

/// How episodes of an environment are recorded.
#[derive(Clone, Copy)]
pub struct Recordings {
    /// The schema that their files name.
    pub schema: &'static str,
    /// Replays an episode given as text under the name of its file.
    pub replay: fn(&str, &str) -> Result<Replay, GoldenError>,
    /// Starts to record the episode of an instance; none where recordings come from elsewhere.
    pub record: Option<StartRecording>,
}

/// Starts to record the episode of an instance; none in another environment.
pub type StartRecording = fn(&dyn Environment, usize, Labels) -> Option<Box<dyn Record>>;

impl fmt::Debug for Recordings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recordings").field("schema", &self.schema).finish_non_exhaustive()
    }
}

/// A file that cannot be read or does not follow the schema.
#[derive(Debug)]
#[non_exhaustive]
pub enum GoldenError {
    /// The file cannot be read.
    Read(std::io::Error),
    /// The text is not JSON.
    Json(serde_json::Error),
    /// A field is missing, or its value is not what the schema asks for.
    Field {
        /// Path of the field, such as `steps[3].actions[1]`.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl GoldenError {
    pub(crate) fn field(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Field { field: field.into(), reason: reason.into() }
    }
}

impl fmt::Display for GoldenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read(_) => f.write_str("the recorded episode cannot be read"),
            Self::Json(_) => f.write_str("the recorded episode is not JSON"),
            Self::Field { field, reason } => write!(f, "field `{field}` {reason}"),
        }
    }
}

impl std::error::Error for GoldenError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Read(source) => Some(source),
            Self::Json(source) => Some(source),
            Self::Field { .. } => None,
        }
    }
}

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

/// A value and the path that leads to it.
#[derive(Clone)]
pub(crate) struct Field<'a> {
    value: &'a Value,
    path: String,
}

impl<'a> Field<'a> {
    pub(crate) fn root(value: &'a Value) -> Self {
        Self { value, path: String::new() }
    }

    pub(crate) fn value(&self) -> &'a Value {
        self.value
    }

    pub(crate) fn path(&self) -> &str {
        &self.path
    }

    /// Checks what every recorded episode says in front, texts of these names among it; gives its steps.
    pub(crate) fn episode_length(
        &self,
        schema: &str,
        names: &[&str],
    ) -> Result<usize, GoldenError> {
        let named = self.get("schema")?;
        if named.text()? != schema {
            return Err(named.refuse(format!("is not `{schema}`")));
        }
        for name in names {
            self.get(name)?.text()?;
        }
        self.get("seed")?.integer(0..=u64::MAX)?;
        Ok(self.get("length")?.integer(0..=1_000_000)? as usize)
    }

    /// A member of this object, if it is there.
    pub(crate) fn find(&self, name: &str) -> Result<Option<Self>, GoldenError> {
        let object = self.value.as_object().ok_or_else(|| self.refuse("is not an object"))?;
        let path = if self.path.is_empty() { name.into() } else { format!("{}.{name}", self.path) };
        Ok(object.get(name).map(|value| Self { value, path }))
    }

    /// A member that this object must have.
    pub(crate) fn get(&self, name: &str) -> Result<Self, GoldenError> {
        self.find(name)?.ok_or_else(|| {
            let path = &self.path;
            let dot = if path.is_empty() { "" } else { "." };
            GoldenError::field(format!("{path}{dot}{name}"), "is missing")
        })
    }

    /// The items of this list.
    pub(crate) fn items(&self) -> Result<Vec<Self>, GoldenError> {
        let list = self.value.as_array().ok_or_else(|| self.refuse("is not a list"))?;
        let item = |(index, value)| Self { value, path: format!("{}[{index}]", self.path) };
        Ok(list.iter().enumerate().map(item).collect())
    }

    /// The items of this list, which must be so many.
    pub(crate) fn exactly(&self, count: usize) -> Result<Vec<Self>, GoldenError> {
        let items = self.items()?;
        if items.len() != count {
            let found = items.len();
            return Err(self.refuse(format!("has {found} entries instead of {count}")));
        }
        Ok(items)
    }

    pub(crate) fn number(&self) -> Result<f64, GoldenError> {
        self.value.as_f64().ok_or_else(|| self.refuse("is not a number"))
    }

    pub(crate) fn integer(&self, range: RangeInclusive<u64>) -> Result<u64, GoldenError> {
        let (low, high) = (range.start(), range.end());
        self.value
            .as_u64()
            .filter(|value| range.contains(value))
            .ok_or_else(|| self.refuse(format!("is not an integer from {low} to {high}")))
    }

    pub(crate) fn flag(&self) -> Result<bool, GoldenError> {
        self.value.as_bool().ok_or_else(|| self.refuse("is neither true nor false"))
    }

    pub(crate) fn text(&self) -> Result<&'a str, GoldenError> {
        self.value.as_str().ok_or_else(|| self.refuse("is not a text"))
    }

    /// What a single letter stands for.
    pub(crate) fn letter<T>(&self, meaning: fn(char) -> Option<T>) -> Result<T, GoldenError> {
        let mut letters = self.text()?.chars();
        match (letters.next().and_then(meaning), letters.next()) {
            (Some(meaning), None) => Ok(meaning),
            _ => Err(self.refuse("is not the letter of a type")),
        }
    }

    pub(crate) fn refuse(&self, reason: impl Into<String>) -> GoldenError {
        let path = if self.path.is_empty() { "(the whole file)" } else { &self.path };
        GoldenError::field(path, reason)
    }
}
