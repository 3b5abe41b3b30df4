//! The files of a record: one, or several of which the newest are kept. Each is finished while the next one is written.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use serde::Serialize;
use sortie_record::{Finished, RecordError, finish};

use super::log::{Log, TICK};
use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Common, plural, print_json, say};

/// How a record is divided into files.
#[derive(Clone, Debug)]
pub(super) struct Division {
    pub(super) path: PathBuf,
    /// Whether there may be several.
    pub(super) is_numbered: bool,
    /// Files that are kept; all of them where this is none.
    pub(super) keep: Option<usize>,
}

/// The files of a record.
pub(super) struct Files {
    division: Division,
    common: Common,
    /// The number of the newest.
    number: u32,
    written: VecDeque<PathBuf>,
    finishing: Option<JoinHandle<Outcome>>,
}

/// A file that is being written.
pub(super) struct Open {
    pub(super) path: PathBuf,
    pub(super) file: File,
}

/// What became of a record, for scripts.
#[derive(Serialize)]
struct Became<'a> {
    file: &'a Path,
    ticks: u64,
    messages: u64,
    /// Messages that came and went before they were read, by their numbers.
    missed: u64,
    bytes_running: u64,
    bytes: u64,
    /// Where it had been cut off, if it was.
    torn_at: Option<u64>,
    /// What made a flight recorder write it.
    why: Option<&'a str>,
}

impl Files {
    pub(super) fn new(division: Division, common: Common) -> Self {
        Self { division, common, number: 0, written: VecDeque::new(), finishing: None }
    }

    /// Begins a file. One that has a number takes the next that is free: earlier recorders may have left some.
    pub(super) fn create(&mut self) -> Result<Open, Failure> {
        loop {
            self.number += 1;
            let Division { path, is_numbered, .. } = &self.division;
            let path = if *is_numbered { numbered(path, self.number) } else { path.clone() };
            match File::create_new(&path) {
                Ok(file) => return Ok(Open { path, file }),
                Err(error) if error.kind() != ErrorKind::AlreadyExists => {
                    return Err(Failure::file(&path, &error));
                }
                Err(_) if *is_numbered => {}
                Err(_) => {
                    let there = format!("{} is there already", path.display());
                    let message = format!("{there}: name another file by --output");
                    return Err(Failure::new(Exit::Usage, message));
                }
            }
        }
    }

    /// Has a file finished, and those that are too many removed.
    pub(super) fn close(&mut self, path: PathBuf, missed: u64, why: Option<String>) -> Outcome {
        self.wait()?;
        self.written.push_back(path.clone());
        while self.division.keep.is_some_and(|keep| self.written.len() > keep) {
            let Some(oldest) = self.written.pop_front() else { break };
            fs::remove_file(&oldest).map_err(|error| Failure::file(&oldest, &error))?;
        }
        let common = self.common;
        self.finishing = Some(std::thread::spawn(move || {
            let finished = finished(&path)?;
            tell(&path, missed, &finished, why.as_deref(), common);
            Ok(())
        }));
        Ok(())
    }

    /// Waits until all files are finished.
    pub(super) fn wait(&mut self) -> Outcome {
        let Some(finishing) = self.finishing.take() else { return Ok(()) };
        finishing.join().unwrap_or_else(|_| Err(Failure::new(Exit::Bug, "a file was not finished")))
    }
}

/// `run-3.mcap` of `run.mcap`.
fn numbered(path: &Path, number: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().map(|ending| format!(".{}", ending.to_string_lossy()));
    path.with_file_name(format!("{stem}-{number}{}", ending.unwrap_or_default()))
}

/// What is said at the end of a file.
pub(super) fn said(missed: u64, why: Option<&str>) -> Vec<(&'static str, String)> {
    let mut said = vec![("missed", missed.to_string())];
    said.extend(why.map(|why| ("why", why.to_owned())));
    said
}

/// What [`said`] is called.
pub(super) const SAID: &str = "sortie.record";

/// A record that goes into files as it happens, into the next one where one has become large.
pub(super) struct Written {
    files: Files,
    open: Open,
    bytes: u64,
    /// Bytes after which the next file begins.
    most: Option<u64>,
    /// It ends in the midst of a message, and nothing is to be written behind that.
    is_torn: bool,
}

impl Written {
    pub(super) fn new(mut files: Files, most: Option<u64>) -> Result<Self, Failure> {
        let open = files.create()?;
        Ok(Self { files, open, bytes: 0, most, is_torn: false })
    }

    /// Writes what was added.
    pub(super) fn look(&mut self, log: &mut Log) -> Outcome {
        let Self { open: Open { path, file }, .. } = self;
        let flushed = log.writer.flush(file);
        self.is_torn = flushed.is_err();
        self.bytes += flushed.map_err(|error| full(path, &error))? as u64;
        if self.most.is_some_and(|most| self.bytes >= most) {
            let next = self.files.create()?;
            close(&mut self.files, std::mem::replace(&mut self.open, next), log)?;
            self.bytes = 0;
        }
        Ok(())
    }

    pub(super) fn end(self, log: &mut Log) -> Outcome {
        let Self { mut files, open, is_torn, .. } = self;
        if !is_torn {
            close(&mut files, open, log)?;
        }
        files.wait()
    }
}

fn close(files: &mut Files, Open { path, mut file }: Open, log: &mut Log) -> Outcome {
    let missed = log.end_file();
    let ended = log.writer.end(&mut file, (SAID, &said(missed, None)));
    ended.map_err(|error| full(&path, &error))?;
    files.close(path, missed, None)
}

/// A record that cannot go on: the team does, and what was written before can be read.
pub(super) fn full(path: &Path, error: &io::Error) -> Failure {
    let path = path.display();
    let message = format!(
        "{path}: {error}; what it holds can be finished where there is room: sortie record --finish {path}"
    );
    Failure::new(Exit::InputOutput, message)
}

pub(super) fn finish_alone(file: &Path, common: Common) -> Outcome {
    let finished = finished(file)?;
    if finished.was_finished && !common.json {
        say!("{} is finished", file.display());
        return Ok(());
    }
    tell(file, 0, &finished, None, common);
    Ok(())
}

fn finished(file: &Path) -> Result<Finished, Failure> {
    finish(file).map_err(|error| match error {
        RecordError::Io(error) => Failure::file(file, &error),
        other => Failure::new(Exit::BadData, format!("{}: {other}", file.display())),
    })
}

fn tell(file: &Path, missed: u64, finished: &Finished, why: Option<&str>, common: Common) {
    let Finished { messages, bytes_before, bytes, torn_at, .. } = *finished;
    let ticks = finished.by_channel.get(&TICK).copied().unwrap_or(0);
    if common.json {
        let bytes_running = bytes_before;
        print_json(&Became { file, ticks, messages, missed, bytes_running, bytes, torn_at, why });
        return;
    }
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    let sizes = format!("{:.1} MB, {:.1} before", megabytes(bytes), megabytes(bytes_before));
    say!("{}: {}, {sizes}", file.display(), plural(messages as usize, "message"));
    if let Some(why) = why {
        say!("it ends with this: {why}");
    }
    if let Some(at) = torn_at {
        say!("it had been cut off at byte {at}");
    }
    if missed > 0 {
        say!("{} came and went before they were read", plural(missed as usize, "message"));
    }
}

#[cfg(test)]
mod tests {
    use sortie_core::Shape;
    use sortie_ipc::{DomainContract, DomainFacts};

    use super::*;

    #[test]
    fn a_file_without_an_ending_has_none_with_a_number() {
        assert_eq!(numbered(Path::new("a/run.mcap"), 3), Path::new("a/run-3.mcap"));
        assert_eq!(numbered(Path::new("a/run"), 3), Path::new("a/run-3"));
    }

    #[test]
    fn nothing_is_written_behind_what_was_written_in_part() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.mcap");
        let division = Division { path: path.clone(), is_numbered: false, keep: None };
        let common = Common { json: true, seed: 1, quiet: true };
        let mut written = Written::new(Files::new(division, common), None)
            .unwrap_or_else(|it| panic!("{}", it.message));
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        let facts = DomainFacts::new(&DomainContract::default(), shape);
        let mut log = Log::new(&facts, 0).unwrap_or_else(|it| panic!("{}", it.message));
        // A descriptor that cannot be written to stands for a disk that is full, and has room again afterwards.
        let with_room =
            std::mem::replace(&mut written.open.file, File::open(&path).expect("it is there"));
        assert!(written.look(&mut log).is_err());
        written.open.file = with_room;
        assert!(written.end(&mut log).is_ok());
        assert_eq!(fs::read(&path).expect("it is there"), b"");
    }
}
