//! A run's evaluations as TensorBoard shows them.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Serialize;

use super::Row;
use super::tensorboard::EventFile;
use crate::error::LearnError;

/// Quantities about learning itself, by the beginning of their names; all others, of whatever environment, are measured
/// by playing greedy episodes.
const LEARNING: [&str; 10] = [
    "updates",
    "decisions",
    "wall_s",
    "cpu_s",
    "loss",
    "gradient_norm",
    "allocator_",
    "epsilon",
    "learning_rate",
    "training_",
];
/// The axis, which is no quantity.
const STEP: &str = "env_steps";

/// What this process tells TensorBoard of a run.
#[derive(Debug)]
pub struct RunEvents {
    folder: PathBuf,
    /// Begun at the first point.
    file: Option<EventFile>,
    /// The first step that the file speaks of.
    first: u64,
}

impl RunEvents {
    /// Nothing is written before the first point.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), file: None, first: 0 }
    }

    /// Makes void what earlier files say of steps after this one: an interrupted run may have gone further
    /// than the checkpoint that it goes on from.
    pub fn goes_on_from(&mut self, env_steps: u64) {
        self.first = if env_steps > 0 { env_steps + 1 } else { 0 };
    }

    /// Adds every number of the newest point of a curve, under `evaluation/` or `learning/`, at its
    /// `env_steps`.
    pub fn add(&mut self, curve: &[impl Serialize]) -> Result<(), LearnError> {
        curve.last().map_or(Ok(()), |point| self.write(point, &tag))
    }

    /// Adds every number of a point between evaluations, under `training/`, at its `env_steps`.
    pub fn add_training(&mut self, point: &impl Serialize) -> Result<(), LearnError> {
        self.write(point, &|name| format!("training/{name}"))
    }

    fn write(
        &mut self,
        point: &impl Serialize,
        tag: &dyn Fn(&str) -> String,
    ) -> Result<(), LearnError> {
        let bad = |reason: &dyn ToString| LearnError::format(&self.folder, reason.to_string());
        let row = Row::of(point).map_err(|error| bad(&error))?;
        let step = row.number(STEP).ok_or_else(|| bad(&"a point has no `env_steps`"))? as u64;
        let values = row.numbers().filter(|(name, _)| *name != STEP);
        let values: Vec<(String, f64)> = values.map(|(name, value)| (tag(name), value)).collect();
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(EventFile::begin(&self.folder, now_s(), self.first)?),
        };
        file.scalars(now_s(), step, values.iter().map(|(tag, value)| (tag.as_str(), *value)))
    }
}

fn tag(name: &str) -> String {
    let learning = LEARNING.iter().any(|beginning| name.starts_with(beginning));
    format!("{}/{name}", if learning { "learning" } else { "evaluation" })
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

    /// The content of all event files in the order of their names.
    fn written(folder: &Path) -> Vec<Vec<u8>> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
    }

    const POINTS: [Point; 3] = [
        Point { env_steps: 10, success: 0.25, loss: 3.0 },
        Point { env_steps: 20, success: 0.5, loss: 2.0 },
        Point { env_steps: 30, success: 0.75, loss: 1.0 },
    ];

    #[test]
    fn every_number_gets_its_section() {
        let folder = tempfile::tempdir().unwrap();
        RunEvents::new(folder.path()).add(&POINTS[..1]).unwrap();
        let files = written(folder.path());
        let text = String::from_utf8_lossy(&files[0]);
        assert!(text.contains("evaluation/success") && text.contains("learning/loss"), "{text}");
        assert!(!text.contains(STEP), "{text}");
    }

    #[test]
    fn a_resumed_run_begins_a_file_that_makes_later_points_void() {
        let folder = tempfile::tempdir().unwrap();
        let mut events = RunEvents::new(folder.path());
        for points in 1..=3 {
            events.add(&POINTS[..points]).unwrap();
        }
        // The checkpoint was written at the first point.
        let mut events = RunEvents::new(folder.path());
        events.goes_on_from(10);
        events.add(&POINTS[..2]).unwrap();
        let files = written(folder.path());
        assert_eq!(files.len(), 2);
        // Step 11 of a session that starts: fields 2 and 7 of the second event.
        let start = [0x10, 11, 0x3a, 2, 8, 1];
        assert!(files[1].windows(6).any(|bytes| bytes == start), "{:?}", files[1]);
        assert!(!files[0].windows(6).any(|bytes| bytes == start));
    }

    #[test]
    fn training_has_a_section_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        RunEvents::new(folder.path()).add_training(&POINTS[0]).unwrap();
        let text = String::from_utf8_lossy(&written(folder.path())[0]).into_owned();
        assert!(text.contains("training/loss") && !text.contains("learning/"), "{text}");
    }

    #[test]
    fn a_point_without_a_step_is_refused() {
        #[derive(Serialize)]
        struct Nowhere {
            success: f64,
        }
        let folder = tempfile::tempdir().unwrap();
        let error = RunEvents::new(folder.path()).add(&[Nowhere { success: 0.5 }]).unwrap_err();
        assert!(error.to_string().contains("env_steps"), "{error}");
    }
}
