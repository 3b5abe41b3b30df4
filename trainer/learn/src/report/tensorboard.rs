//! A run's evaluations as TensorBoard shows them: event files of scalars over environment steps.
//!
//! A file is a sequence of TFRecords, each a serialised `Event` of TensorFlow's `event.proto` between its
//! length and its checksum. TensorBoard reads all event files of a folder, in the order of their names, as
//! one run. A run that is resumed begins a new file, whose first event says from which step on earlier
//! points are void: those that came after the checkpoint are shown once, as measured again.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crc::{CRC_32_ISCSI, Crc};
use serde::Serialize;

use super::Row;
use crate::error::{LearnError, Result};
use crate::protobuf::Message;

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
pub(crate) struct RunEvents {
    folder: PathBuf,
    /// Begun at the first point.
    file: Option<EventFile>,
    /// The first step that the file speaks of.
    first: u64,
}

impl RunEvents {
    /// Nothing is written before the first point.
    pub(crate) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), file: None, first: 0 }
    }

    /// Makes void what earlier files say of steps after this one: an interrupted run may have gone further
    /// than the checkpoint that it goes on from.
    pub(crate) fn goes_on_from(&mut self, env_steps: u64) {
        self.first = if env_steps > 0 { env_steps + 1 } else { 0 };
    }

    /// Adds every number of the newest point of a curve, under `evaluation/` or `learning/`, at its
    /// `env_steps`.
    pub(crate) fn add(&mut self, curve: &[impl Serialize]) -> Result<()> {
        curve.last().map_or(Ok(()), |point| self.write(point, &tag))
    }

    /// Adds every number of a point between evaluations, under `training/`, at its `env_steps`.
    pub(crate) fn add_training(&mut self, point: &impl Serialize) -> Result<()> {
        self.write(point, &|name| format!("training/{name}"))
    }

    fn write(&mut self, point: &impl Serialize, tag: &dyn Fn(&str) -> String) -> Result<()> {
        let bad = |reason: &dyn ToString| LearnError::format(&self.folder, reason.to_string());
        let row = Row::of(point).map_err(|error| bad(&error))?;
        let step = row.number(STEP).ok_or_else(|| bad(&"a point has no `env_steps`"))? as u64;
        let values = row.numbers().filter(|(name, _)| *name != STEP);
        let values: Vec<(String, f64)> = values.map(|(name, value)| (tag(name), value)).collect();
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(EventFile::begin(&self.folder, now_s(), self.first)?),
        };
        file.scalars(now_s(), step, &values)
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

/// Every event file's name begins so; the seconds since 1970 follow, then [`SUFFIX`].
const PREFIX: &str = "events.out.tfevents.";
const SUFFIX: &str = ".sortie";
/// The version from which on TensorBoard minds the start of a session.
const FILE_VERSION: &str = "brain.Event:2";
/// A session starts.
const START: i64 = 1;

/// An event file under construction; each event is in the file when its call returns.
#[derive(Debug)]
struct EventFile {
    path: PathBuf,
    file: File,
    /// Bytes of whole records.
    length: u64,
}

impl EventFile {
    /// Begins a file in the folder of a run, after all earlier ones.
    ///
    /// `now_s` is the time in seconds since 1970; `first_step` is the first step that this file may
    /// speak of: what earlier files say of it and of later steps is void.
    fn begin(folder: &Path, now_s: f64, first_step: u64) -> Result<Self> {
        fs::create_dir_all(folder).map_err(LearnError::file(folder))?;
        let mut seconds = newest(folder)?.map_or(now_s as u64, |last| last.max(now_s as u64));
        let (path, file) = loop {
            let path = folder.join(format!("{PREFIX}{seconds:010}{SUFFIX}"));
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => break (path, file),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => seconds += 1,
                Err(error) => return Err(LearnError::file(path)(error)),
            }
        };
        let mut begun = Self { path, file, length: 0 };
        let written = begun.write(event(now_s, 0).text(3, FILE_VERSION));
        let start = Message::default().integer(1, START);
        match written.and_then(|()| begun.write(event(now_s, first_step).message(7, &start))) {
            Ok(()) => Ok(begun),
            Err(error) => {
                // The first error matters.
                let _ = fs::remove_file(&begun.path);
                Err(error)
            }
        }
    }

    /// Adds the values of named quantities at a step.
    fn scalars(&mut self, now_s: f64, step: u64, values: &[(String, f64)]) -> Result<()> {
        let value =
            |(tag, value): &(String, f64)| Message::default().text(1, tag).float(2, *value as f32);
        let values: Vec<Message> = values.iter().map(value).collect();
        self.write(event(now_s, step).message(5, &Message::default().messages(1, &values)))
    }

    fn write(&mut self, event: Message) -> Result<()> {
        // One call, so that a reader beside rarely sees half a record.
        let record = record(&event.into_bytes());
        let written = self.file.write_all(&record);
        if written.is_ok() {
            self.length += record.len() as u64;
        } else {
            // A full disk may have taken half of it.
            let _ = self.file.set_len(self.length);
        }
        written.map_err(LearnError::file(&self.path))
    }
}

/// The seconds in the name of the newest event file.
fn newest(folder: &Path) -> Result<Option<u64>> {
    let entries = fs::read_dir(folder).map_err(LearnError::file(folder))?;
    let seconds = |name: &str| name.strip_prefix(PREFIX)?.strip_suffix(SUFFIX)?.parse::<u64>().ok();
    Ok(entries.flatten().filter_map(|entry| seconds(entry.file_name().to_str()?)).max())
}

fn event(now_s: f64, step: u64) -> Message {
    Message::default().double(1, now_s).integer(2, step as i64)
}

/// A TFRecord: length, its checksum, content, its checksum.
fn record(content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    let mut record = length.to_vec();
    record.extend(checksum(&length).to_le_bytes());
    record.extend(content);
    record.extend(checksum(content).to_le_bytes());
    record
}

/// The CRC-32C, turned and shifted, so that records within records do not confuse it.
fn checksum(content: &[u8]) -> u32 {
    static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
    CRC.checksum(content).rotate_right(15).wrapping_add(0xa282_ead8)
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

    /// Reads one field of a message: its number, its wire type and its bytes.
    fn field<'a>(bytes: &mut &'a [u8]) -> (u64, &'a [u8]) {
        fn varint(bytes: &mut &[u8]) -> u64 {
            let mut value = 0;
            for shift in (0..).step_by(7) {
                let byte = bytes[0];
                *bytes = &bytes[1..];
                value |= u64::from(byte & 0x7f) << shift;
                if byte < 0x80 {
                    break;
                }
            }
            value
        }
        let tag = varint(bytes);
        let length = match tag & 7 {
            0 => {
                let start = *bytes;
                varint(bytes);
                let length = start.len() - bytes.len();
                *bytes = start;
                length
            }
            1 => 8,
            2 => varint(bytes) as usize,
            5 => 4,
            other => panic!("wire type {other}"),
        };
        let (value, rest) = bytes.split_at(length);
        *bytes = rest;
        (tag >> 3, value)
    }

    fn fields(mut bytes: &[u8]) -> Vec<(u64, &[u8])> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            found.push(field(&mut bytes));
        }
        found
    }

    fn part<'a>(fields: &[(u64, &'a [u8])], number: u64) -> Option<&'a [u8]> {
        fields.iter().find(|(other, _)| *other == number).map(|(_, value)| *value)
    }

    /// The contents of the records, their checksums checked.
    fn records(mut bytes: &[u8]) -> Vec<&[u8]> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let (length, rest) = bytes.split_at(8);
            let (length_sum, rest) = rest.split_at(4);
            assert_eq!(length_sum, checksum(length).to_le_bytes());
            let (content, rest) =
                rest.split_at(u64::from_le_bytes(length.try_into().unwrap()) as usize);
            let (sum, rest) = rest.split_at(4);
            assert_eq!(sum, checksum(content).to_le_bytes());
            found.push(content);
            bytes = rest;
        }
        found
    }

    #[test]
    fn the_checksum_is_that_of_the_format() {
        // The head of a record of 24 bytes, as the writer of TensorBoard makes it.
        assert_eq!(record(&[0; 24])[..12], [24, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22]);
    }

    #[test]
    fn what_is_written_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = EventFile::begin(folder.path(), 1000.5, 1).unwrap();
        let values = [("evaluation/success", 0.25), ("learning/loss", 3.0)];
        let values = values.map(|(tag, value)| (tag.to_owned(), value));
        file.scalars(1001.5, 50_000, &values).unwrap();
        let bytes = fs::read(&file.path).unwrap();
        let events: Vec<_> = records(&bytes).into_iter().map(fields).collect();
        assert_eq!(events.len(), 3);
        assert_eq!(part(&events[0], 3), Some(FILE_VERSION.as_bytes()));
        assert_eq!(part(&events[1], 2), Some(&[1][..]), "the first step");
        assert_eq!(part(&events[1], 7), Some(&[8, 1][..]), "a session starts");
        assert_eq!(part(&events[2], 1), Some(&1001.5_f64.to_le_bytes()[..]));
        assert_eq!(part(&events[2], 2), Some(&[0xd0, 0x86, 0x03][..]), "50,000 as a varint");
        let values = fields(part(&events[2], 5).unwrap());
        let value = |index: usize| {
            let fields = fields(values[index].1);
            let tag = String::from_utf8(part(&fields, 1).unwrap().to_vec()).unwrap();
            (tag, f32::from_le_bytes(part(&fields, 2).unwrap().try_into().unwrap()))
        };
        assert_eq!(values.len(), 2);
        assert_eq!(value(0), ("evaluation/success".to_owned(), 0.25));
        assert_eq!(value(1), ("learning/loss".to_owned(), 3.0));
    }

    #[test]
    fn a_later_file_comes_after_the_earlier_ones_even_if_the_clock_goes_back() {
        let folder = tempfile::tempdir().unwrap();
        let names: Vec<PathBuf> = [1000.0, 1000.9, 500.0]
            .into_iter()
            .map(|now_s| EventFile::begin(folder.path(), now_s, 1).unwrap().path)
            .collect();
        assert!(names.is_sorted(), "{names:?}");
        assert!(names[2].ends_with("events.out.tfevents.0000001002.sortie"), "{names:?}");
    }
}
