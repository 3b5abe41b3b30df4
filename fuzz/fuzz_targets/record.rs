//! Records: read to their end or refused, never a panic; of one that was cut, everything before is kept.
#![no_main]

use std::io::Cursor;

use libfuzzer_sys::fuzz_target;
use sortie_record::{Reader, Record, RecordError};

/// Messages until the end, and how it ends.
fn messages(bytes: &[u8]) -> (usize, Option<RecordError>) {
    let mut reader = match Reader::new(Cursor::new(bytes)) {
        Ok(reader) => reader,
        Err(error) => return (0, Some(error)),
    };
    let mut messages = 0;
    loop {
        match reader.next() {
            Ok(Some(Record::Message(..))) => messages += 1,
            Ok(Some(_)) => {}
            Ok(None) => return (messages, None),
            Err(error) => return (messages, Some(error)),
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let (whole, error) = messages(bytes);
    assert!(error.is_none_or(|error| !error.to_string().is_empty()));
    let (half, _) = messages(&bytes[..bytes.len() / 2]);
    assert!(half <= whole, "{half} of {whole}");
});
