//! What was written is read, whatever became of its end.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::PathBuf;

use crate::{Finished, Message, Reader, Recent, Record, RecordError, Writer, finish};

/// Messages of the record below.
const MESSAGES: u32 = 40;

/// The content of [`written`] so far as it is no message.
fn begun() -> Writer {
    let mut writer = Writer::new("sortie", "a test");
    writer.add_schema(1, ["numbers", "own"], b"one number after the other");
    writer.add_channel(7, 1, ["/numbers", "own"]);
    writer.add_attachment(["notes.txt", "text/plain"], 5, b"what is to be known");
    writer
}

fn add(writer: &mut Writer, sequence: u32) {
    let log_time = 100 + 2 * u64::from(sequence);
    let message = Message { channel: 7, sequence, log_time, publish_time: 9 };
    writer.add_message(message, &[&sequence.to_le_bytes(), &[3; 50]]);
}

/// What is said at the end of a file.
fn half() -> [(&'static str, String); 1] {
    [("way", "there".to_owned())]
}

/// A record of everything that a record has, flushed after every message: where each of them ends.
fn written() -> (Vec<u8>, Vec<usize>) {
    let (mut writer, mut bytes, mut ends) = (begun(), Vec::new(), Vec::new());
    for sequence in 0..MESSAGES {
        add(&mut writer, sequence);
        writer.flush(&mut bytes).expect("memory");
        ends.push(bytes.len());
    }
    writer.end(&mut bytes, ("half", &half())).expect("memory");
    (bytes, ends)
}

/// Counts of all that is read, messages first, and how it ends.
fn read(bytes: &[u8]) -> (u32, u32, Option<RecordError>) {
    let (mut messages, mut others) = (0, 0);
    let mut reader = match Reader::new(Cursor::new(bytes)) {
        Ok(reader) => reader,
        Err(error) => return (0, 0, Some(error)),
    };
    loop {
        match reader.next() {
            Ok(Some(Record::Message(message, data))) => {
                assert_eq!((message.channel, message.sequence), (7, messages));
                assert_eq!(data[..4], messages.to_le_bytes());
                messages += 1;
            }
            Ok(Some(record)) => others += u32::from(is_sound(&record)),
            Ok(None) => return (messages, others, None),
            Err(error) => return (messages, others, Some(error)),
        }
    }
}

/// Whether a record is one that was written, and says what it said.
fn is_sound(record: &Record<'_>) -> bool {
    match record {
        Record::Header { profile, library } => (*profile, *library) == ("sortie", "a test"),
        Record::Schema { id: 1, name: "numbers", encoding: "own", data } => data.len() == 26,
        Record::Channel { id: 7, schema: 1, topic: "/numbers", encoding: "own" } => true,
        Record::Attachment { name: "notes.txt", data } => *data == b"what is to be known",
        Record::Metadata { name: "half", entries } => entries[..] == [("way", "there")],
        Record::DataEnd => true,
        _ => false,
    }
}

fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("there is room");
    (folder, path)
}

#[test]
fn what_is_written_is_read_before_and_after_it_is_finished() {
    let (bytes, _) = written();
    // Header, schema, channel, attachment, metadata and the end.
    assert!(matches!(read(&bytes), (MESSAGES, 6, None)));
    let (_folder, path) = file("whole.mcap", &bytes);
    let finished = finish(&path).expect("it is sound");
    assert_eq!((finished.messages, finished.torn_at), (u64::from(MESSAGES), None));
    assert_eq!(finished.by_channel, BTreeMap::from([(7, finished.messages)]));
    assert_eq!(finished.bytes_before, bytes.len() as u64);
    let after = fs::read(&path).expect("it is there");
    assert_eq!(finished.bytes, after.len() as u64);
    // The index repeats schema and channel.
    assert!(matches!(read(&after), (MESSAGES, 8, None)));
    let again = finish(&path).expect("it is there");
    let expected = Finished { was_finished: true, bytes_before: again.bytes, ..again.clone() };
    assert_eq!(again, expected);
    assert_eq!(fs::read(&path).expect("it is there"), after);
}

#[test]
fn a_record_that_is_cut_anywhere_has_all_that_was_flushed_before() {
    let (bytes, ends) = written();
    for length in 8..bytes.len() - 8 {
        let whole = ends.iter().filter(|end| **end <= length).count() as u32;
        let (messages, _, error) = read(&bytes[..length]);
        assert_eq!(messages, whole, "{length}");
        assert!(matches!(error, None | Some(RecordError::Torn { .. })), "{length}: {error:?}");
        if length % 97 == 0 {
            let (_folder, path) = file("cut.mcap", &bytes[..length]);
            let finished = finish(&path).expect("it can be mended");
            assert_eq!(finished.messages, u64::from(messages), "{length}");
            // Nothing is lost with a footer that is cut.
            assert!(finished.torn_at.is_none() || error.is_some(), "{length}");
            let (again, _, error) = read(&fs::read(&path).expect("it is there"));
            assert!(again == messages && error.is_none(), "{length}: {error:?}");
        }
    }
}

#[test]
fn no_byte_that_is_changed_within_a_chunk_goes_unseen() {
    let (bytes, _) = written();
    let (_folder, path) = file("whole.mcap", &bytes);
    finish(&path).expect("it is sound");
    let bytes = fs::read(&path).expect("it is there");
    let packed = bytes.windows(3).position(|three| three == b"lz4").expect("a chunk") + 11;
    for at in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[at] ^= 0x10;
        let error = Reader::new(Cursor::new(&changed)).and_then(|mut reader| {
            while reader.next()?.is_some() {}
            Ok(())
        });
        let is_packed = (packed..packed + 100).contains(&at);
        assert!(error.is_err() || !is_packed, "byte {at}");
    }
}

#[test]
fn what_is_no_record_is_refused_by_name() {
    for bytes in [&b""[..], b"\x89MCAP", b"some other file that is long enough"] {
        assert!(matches!(read(bytes), (0, 0, Some(RecordError::NotARecord))), "{bytes:?}");
    }
    let (mut bytes, _) = written();
    // The length of the schema's name.
    let name = bytes.windows(7).position(|word| word == b"numbers").expect("it") - 4;
    bytes[name] = 200;
    let (.., error) = read(&bytes);
    let said = error.expect("it is broken").to_string();
    assert!(said.starts_with("a schema at byte "), "{said}");
}

/// The numbers of a file's messages; each file has all the rest.
fn numbers(bytes: &[u8]) -> Vec<u32> {
    let mut reader = Reader::new(Cursor::new(bytes)).expect("a record");
    let (mut numbers, mut others) = (Vec::new(), 0);
    while let Some(record) = reader.next().expect("it is whole") {
        match record {
            Record::Message(message, _) => numbers.push(message.sequence),
            record => others += u32::from(is_sound(&record)),
        }
    }
    assert_eq!(others, 6, "header, schema, channel, attachment, metadata and the end");
    numbers
}

#[test]
fn a_record_goes_on_in_another_file() {
    let (mut writer, mut bytes) = (begun(), [Vec::new(), Vec::new()]);
    for sequence in 0..MESSAGES {
        add(&mut writer, sequence);
        let file = &mut bytes[usize::from(sequence >= 15)];
        writer.flush(file).expect("memory");
        if sequence == 14 {
            writer.end(file, ("half", &half())).expect("memory");
        }
    }
    writer.end(&mut bytes[1], ("half", &half())).expect("memory");
    let [first, second] = bytes.map(|bytes| numbers(&bytes));
    assert_eq!(first, Vec::from_iter(0..15));
    assert_eq!(second, Vec::from_iter(15..MESSAGES));
}

#[test]
fn the_newest_are_kept_until_they_are_saved() {
    let (mut writer, mut recent) = (begun(), Recent::new(10));
    let mut bytes = [Vec::new(), Vec::new()];
    for sequence in 0..MESSAGES {
        add(&mut writer, sequence);
        recent.keep(&mut writer, u64::from(sequence));
        if sequence == 25 {
            recent.save(&mut writer, &mut bytes[0], ("half", &half())).expect("memory");
            assert_eq!(recent.bytes(), 0);
        }
    }
    let kept = recent.bytes();
    let saved = recent.save(&mut writer, &mut bytes[1], ("half", &half())).expect("memory");
    assert!(saved > kept && saved == bytes[1].len(), "{saved} of {kept}");
    let [first, second] = bytes.map(|bytes| numbers(&bytes));
    assert_eq!(first, Vec::from_iter(15..=25));
    assert_eq!(second, Vec::from_iter(29..MESSAGES));
}
