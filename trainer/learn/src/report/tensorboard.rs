//! Event files of TensorBoard: scalars over environment steps.
//!
//! A file is a sequence of TFRecords, each a serialised `Event` of TensorFlow's `event.proto` between its
//! length and its checksum. TensorBoard reads all event files of a folder, in the order of their names, as
//! one run. A run that is resumed begins a new file, whose first event says from which step on earlier
//! points are void: those that came after the checkpoint are shown once, as measured again.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use crc::{CRC_32_ISCSI, Crc};

use crate::error::LearnError;
use crate::protobuf::Message;

/// Every event file's name begins so; the seconds since 1970 follow, then [`SUFFIX`].
const PREFIX: &str = "events.out.tfevents.";
const SUFFIX: &str = ".sortie";
/// The version from which on TensorBoard minds the start of a session.
const FILE_VERSION: &str = "brain.Event:2";

/// An event file under construction; each event is in the file when its call returns.
#[derive(Debug)]
pub struct EventFile {
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
    pub fn begin(folder: &Path, now_s: f64, first_step: u64) -> Result<Self, LearnError> {
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
        let written = begun.write(&version(now_s));
        match written.and_then(|()| begun.write(&session_start(now_s, first_step))) {
            Ok(()) => Ok(begun),
            Err(error) => {
                // The first error matters.
                let _ = fs::remove_file(&begun.path);
                Err(error)
            }
        }
    }

    /// Adds the values of named quantities at a step.
    pub fn scalars<'a>(
        &mut self,
        now_s: f64,
        step: u64,
        values: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> Result<(), LearnError> {
        self.write(&summary(now_s, step, values))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn write(&mut self, event: &[u8]) -> Result<(), LearnError> {
        // One call, so that a reader beside rarely sees half a record.
        let record = record(event);
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
fn newest(folder: &Path) -> Result<Option<u64>, LearnError> {
    let entries = fs::read_dir(folder).map_err(LearnError::file(folder))?;
    let seconds = |name: &str| name.strip_prefix(PREFIX)?.strip_suffix(SUFFIX)?.parse::<u64>().ok();
    Ok(entries.flatten().filter_map(|entry| seconds(entry.file_name().to_str()?)).max())
}

fn event(now_s: f64, step: u64) -> Message {
    Message::default().double(1, now_s).integer(2, step as i64)
}

fn version(now_s: f64) -> Vec<u8> {
    event(now_s, 0).text(3, FILE_VERSION).into_bytes()
}

fn session_start(now_s: f64, first_step: u64) -> Vec<u8> {
    const START: i64 = 1;
    event(now_s, first_step).message(7, &Message::default().integer(1, START)).into_bytes()
}

fn summary<'a>(now_s: f64, step: u64, values: impl IntoIterator<Item = (&'a str, f64)>) -> Vec<u8> {
    let value = |(tag, value)| Message::default().text(1, tag).float(2, value as f32);
    let values: Vec<Message> = values.into_iter().map(value).collect();
    event(now_s, step).message(5, &Message::default().messages(1, &values)).into_bytes()
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
        file.scalars(1001.5, 50_000, [("evaluation/success", 0.25), ("learning/loss", 3.0)])
            .unwrap();
        let bytes = fs::read(file.path()).unwrap();
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
            .map(|now_s| EventFile::begin(folder.path(), now_s, 1).unwrap().path().to_owned())
            .collect();
        assert!(names.is_sorted(), "{names:?}");
        assert!(names[2].ends_with("events.out.tfevents.0000001002.sortie"), "{names:?}");
    }
}
