//! A run's evaluations as TensorBoard shows them.

use std::path::Path;
use std::time::SystemTime;

use serde::Serialize;

use super::Row;
use super::tensorboard::EventFile;
use crate::error::LearnError;

/// Quantities measured by playing greedy episodes, by the beginning of their names; all others are about
/// learning itself.
const EVALUATION: [&str; 6] =
    ["success", "none_burned", "timeouts", "return_mean", "length_mean", "episodes"];
/// The axis, which is no quantity.
const STEP: &str = "env_steps";

/// The event file of a run in this process.
#[derive(Debug)]
pub struct RunEvents(EventFile);

impl RunEvents {
    /// Begins a file in the run's folder; `env_steps` is 0 for a new run and those of the checkpoint for
    /// a resumed one. Points after them, which an interrupted run may have left, are void.
    pub fn begin(folder: &Path, env_steps: u64) -> Result<Self, LearnError> {
        EventFile::begin(folder, now_s(), env_steps + 1).map(Self)
    }

    /// Adds every number of an evaluation, under `evaluation/` or `learning/`, at its `env_steps`.
    pub fn add(&mut self, point: &impl Serialize) -> Result<(), LearnError> {
        let bad = |reason: &dyn ToString| LearnError::format(self.0.path(), reason.to_string());
        let row = Row::of(point).map_err(|error| bad(&error))?;
        let step = row.number(STEP).ok_or_else(|| bad(&"the point has no `env_steps`"))? as u64;
        let values: Vec<(String, f64)> = row
            .numbers()
            .filter(|(name, _)| *name != STEP)
            .map(|(name, value)| (tag(name), value))
            .collect();
        let values = values.iter().map(|(tag, value)| (tag.as_str(), *value));
        self.0.scalars(now_s(), step, values)
    }
}

fn tag(name: &str) -> String {
    let measured = EVALUATION.iter().any(|beginning| name.starts_with(beginning));
    format!("{}/{name}", if measured { "evaluation" } else { "learning" })
}

/// Seconds since 1970.
fn now_s() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Point {
        env_steps: u64,
        success: f64,
        loss: f64,
    }

    #[test]
    fn every_number_gets_its_section() {
        let folder = tempfile::tempdir().unwrap();
        let mut events = RunEvents::begin(folder.path(), 0).unwrap();
        events.add(&Point { env_steps: 10, success: 0.5, loss: 2.0 }).unwrap();
        let bytes = std::fs::read(events.0.path()).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("evaluation/success") && text.contains("learning/loss"), "{text}");
        assert!(!text.contains(STEP), "{text}");
    }

    #[test]
    fn a_point_without_a_step_is_refused() {
        #[derive(Serialize)]
        struct Nowhere {
            success: f64,
        }
        let folder = tempfile::tempdir().unwrap();
        let mut events = RunEvents::begin(folder.path(), 0).unwrap();
        let error = events.add(&Nowhere { success: 0.5 }).unwrap_err();
        assert!(error.to_string().contains("env_steps"), "{error}");
    }
}
