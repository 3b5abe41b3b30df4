//! The files of a run, and the lock of whoever learns in its folder.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

use sortie_bundle::files::{self, Durability, MOST_BYTES, read_text, replace_file};

use super::{Checkpoints, CurvePoint, RunDescription, RunResult, curve};
use crate::error::{LearnError, Result};
use crate::evaluate::Score;
use crate::report::{CURVE, DESCRIPTION, RESULT, RunEvents, to_csv};

const LOCK: &str = "lock";

/// The files of a run.
#[derive(Debug)]
pub struct RunFolder {
    folder: PathBuf,
    /// What TensorBoard is told.
    pub(crate) events: RunEvents,
    /// Held by the trainer of the run. The kernel frees it when its holder ends, however that is.
    lock: Option<File>,
}

impl RunFolder {
    /// A folder to read, or to [`create`](Self::create) later.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), events: RunEvents::new(folder), lock: None }
    }

    /// The folder of a run to go on with, which nobody else may do meanwhile.
    pub fn claim(folder: &Path) -> Result<Self> {
        let mut run = Self::new(folder);
        let description = run.description_path();
        fs::metadata(&description).map_err(LearnError::file(&description))?;
        run.lock()?;
        files::check_folder(folder).map_err(LearnError::file(folder))?;
        files::remove_drafts(folder);
        run.checkpoints().remove_unfinished();
        Ok(run)
    }

    /// Makes the folder and claims it; refuses one that holds anything.
    pub fn create(&mut self, description: &RunDescription) -> Result<()> {
        let folder = &self.folder;
        if self.description_path().exists() {
            let reason =
                "holds a run already: go on with it by `--resume`, or choose another folder";
            return Err(LearnError::taken(folder, reason));
        }
        fs::create_dir_all(folder).map_err(LearnError::file(folder))?;
        if let Some(name) = foreign_entry(folder)? {
            let reason = format!("is not empty, there is `{name}` in it: choose another folder");
            return Err(LearnError::taken(folder, reason));
        }
        self.lock()?;
        self.write(DESCRIPTION, Ok::<_, String>(description.to_toml()?))
    }

    fn lock(&mut self) -> Result<()> {
        let path = self.folder.join(LOCK);
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = file.map_err(LearnError::file(&path))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                // The number only makes the message better.
                let _ = file.read_to_string(&mut holder);
                return Err(LearnError::Busy { path: self.folder.clone(), process: holder });
            }
            Err(TryLockError::Error(error)) => return Err(LearnError::file(path)(error)),
        }
        let _ = file.set_len(0).and_then(|()| write!(file, "{}", std::process::id()));
        self.lock = Some(file);
        Ok(())
    }

    /// Replaces `train.toml` of a run whose figures are void from now on.
    pub fn rewrite_description(&self, description: &RunDescription) -> Result<()> {
        let result = self.folder.join(RESULT);
        match fs::remove_file(&result) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(LearnError::file(result)(error));
            }
            _ => {}
        }
        self.write(DESCRIPTION, Ok::<_, String>(description.to_toml()?))
    }

    /// How the run learns.
    pub fn read_description(&self) -> Result<RunDescription> {
        let path = self.description_path();
        let text = read_text(&path, MOST_BYTES).map_err(LearnError::file(&path))?;
        RunDescription::from_toml(&text).map_err(|error| LearnError::format(path, error))
    }

    /// Its checkpoints.
    pub fn checkpoints(&self) -> Checkpoints {
        Checkpoints::new(&self.folder.join("checkpoints"))
    }

    /// Replaces `curve.json`, `curve.csv` and `curve.svg`, and tells TensorBoard of the newest point.
    pub fn write_curve(&mut self, title: &str, score: Score, curve: &[CurvePoint]) -> Result<()> {
        self.write(CURVE, curve::to_lines(curve))?;
        self.write("curve.csv", to_csv(curve))?;
        self.events.add(curve)?;
        self.write("curve.svg", curve::learning_curve(title, score, curve))
    }

    /// Writes `result.json`.
    pub fn write_result(&self, result: &RunResult) -> Result<()> {
        self.write(RESULT, serde_json::to_string_pretty(result))
    }

    /// Replaces a file by a text, if that could be made.
    fn write(&self, name: &str, text: Result<String, impl ToString>) -> Result<()> {
        let path = self.folder.join(name);
        let text = text.map_err(|error| LearnError::format(&path, error))?;
        replace_file(&path, text.as_bytes(), Durability::Forced).map_err(LearnError::file(path))
    }

    fn description_path(&self) -> PathBuf {
        self.folder.join(DESCRIPTION)
    }
}

/// Something in a folder that no run left there before it began.
fn foreign_entry(folder: &Path) -> Result<Option<String>> {
    let entries = fs::read_dir(folder).map_err(LearnError::file(folder))?;
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    Ok(names.filter(|name| name != LOCK && !files::is_draft(name)).min())
}
