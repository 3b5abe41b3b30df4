//! Writing as it happens.

use std::io::{self, Write};

use crate::encode::{
    CHECKSUM, MAGIC, list, opcode, put_bytes, put_end, put_header, put_text, put_u16, put_u32,
    put_u64, record,
};

/// Where a message belongs, and when it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its channel.
    pub channel: u16,
    /// Its number among those of its sender, as far as 32 bits count.
    pub sequence: u32,
    /// When it was recorded, in nanoseconds since 1970.
    pub log_time: u64,
    /// When it was sent, in nanoseconds since 1970.
    pub publish_time: u64,
}

/// Writes a record. What is added waits until it is flushed, then is in the file as a whole: nothing that was flushed depends on
/// what comes later.
#[derive(Debug)]
pub struct Writer<W: Write> {
    to: W,
    waiting: Vec<u8>,
    written: u64,
}

impl<W: Write> Writer<W> {
    /// Begins a record: `profile` says what the channels hold, `library` who writes it.
    pub fn new(to: W, profile: &str, library: &str) -> Self {
        let mut waiting = MAGIC.to_vec();
        put_header(&mut waiting, profile, library);
        Self { to, waiting, written: 0 }
    }

    /// How the messages of channels are laid out; `id` is above 0.
    pub fn add_schema(&mut self, id: u16, [name, encoding]: [&str; 2], data: &[u8]) {
        record(&mut self.waiting, opcode::SCHEMA, |to| {
            put_u16(to, id);
            put_text(to, name);
            put_text(to, encoding);
            put_bytes(to, data);
        });
    }

    /// A channel of messages of a schema.
    pub fn add_channel(&mut self, id: u16, schema: u16, [topic, encoding]: [&str; 2]) {
        record(&mut self.waiting, opcode::CHANNEL, |to| {
            put_u16(to, id);
            put_u16(to, schema);
            put_text(to, topic);
            put_text(to, encoding);
            list(to, |_| {});
        });
    }

    /// A message, in parts that follow each other.
    pub fn add_message(&mut self, message: Message, parts: &[&[u8]]) {
        let Message { channel, sequence, log_time, publish_time } = message;
        record(&mut self.waiting, opcode::MESSAGE, |to| {
            put_u16(to, channel);
            put_u32(to, sequence);
            put_u64(to, log_time);
            put_u64(to, publish_time);
            parts.iter().for_each(|part| to.extend(*part));
        });
    }

    /// A file that the record brings along.
    pub fn add_attachment(&mut self, [name, media_type]: [&str; 2], time_ns: u64, data: &[u8]) {
        record(&mut self.waiting, opcode::ATTACHMENT, |to| {
            let first = to.len();
            put_u64(to, time_ns);
            put_u64(to, time_ns);
            put_text(to, name);
            put_text(to, media_type);
            put_u64(to, data.len() as u64);
            to.extend(data);
            let checksum = CHECKSUM.checksum(&to[first..]);
            put_u32(to, checksum);
        });
    }

    /// What is said of something, by names.
    pub fn add_metadata(&mut self, name: &str, entries: &[(&str, String)]) {
        record(&mut self.waiting, opcode::METADATA, |to| {
            put_text(to, name);
            list(to, |to| {
                for (key, value) in entries {
                    put_text(to, key);
                    put_text(to, value);
                }
            });
        });
    }

    /// Writes what waits, by one call.
    ///
    /// # Errors
    /// The file cannot be written, as where the disk is full. What was flushed before stays readable.
    pub fn flush(&mut self) -> io::Result<()> {
        self.to.write_all(&self.waiting)?;
        self.to.flush()?;
        self.written += self.waiting.len() as u64;
        self.waiting.clear();
        Ok(())
    }

    /// Bytes that were flushed.
    pub fn bytes(&self) -> u64 {
        self.written
    }

    /// Ends the record, without an index.
    ///
    /// # Errors
    /// As [`Self::flush`].
    pub fn end(mut self) -> io::Result<W> {
        record(&mut self.waiting, opcode::DATA_END, |to| put_u32(to, 0));
        put_end(&mut self.waiting, 0);
        self.flush()?;
        Ok(self.to)
    }
}
