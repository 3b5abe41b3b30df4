//! Writing as it happens.

use std::io::{self, Write};

use crate::encode::{
    CHECKSUM, MAGIC, opcode, put_bytes, put_end, put_header, put_map, put_metadata, put_text,
    put_u16, put_u32, put_u64, record,
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
/// what comes later. All but the messages is kept, for a file that follows begins with it.
#[derive(Debug)]
pub struct Writer {
    /// All but the messages, and how much of it the file has.
    lasting: Vec<u8>,
    flushed: usize,
    messages: Vec<u8>,
}

impl Writer {
    /// Begins a record: `profile` says what the channels hold, `library` who writes it.
    pub fn new(profile: &str, library: &str) -> Self {
        let mut lasting = MAGIC.to_vec();
        put_header(&mut lasting, profile, library);
        Self { lasting, flushed: 0, messages: Vec::new() }
    }

    /// How the messages of channels are laid out; `id` is above 0.
    pub fn add_schema(&mut self, id: u16, [name, encoding]: [&str; 2], data: &[u8]) {
        record(&mut self.lasting, opcode::SCHEMA, |to| {
            put_u16(to, id);
            put_text(to, name);
            put_text(to, encoding);
            put_bytes(to, data);
        });
    }

    /// A channel of messages of a schema.
    pub fn add_channel(&mut self, id: u16, schema: u16, [topic, encoding]: [&str; 2]) {
        record(&mut self.lasting, opcode::CHANNEL, |to| {
            put_u16(to, id);
            put_u16(to, schema);
            put_text(to, topic);
            put_text(to, encoding);
            put_map(to, &[]);
        });
    }

    /// A message, in parts that follow each other.
    pub fn add_message(&mut self, message: Message, parts: &[&[u8]]) {
        let Message { channel, sequence, log_time, publish_time } = message;
        record(&mut self.messages, opcode::MESSAGE, |to| {
            put_u16(to, channel);
            put_u32(to, sequence);
            put_u64(to, log_time);
            put_u64(to, publish_time);
            parts.iter().for_each(|part| to.extend(*part));
        });
    }

    /// A file that the record brings along.
    pub fn add_attachment(&mut self, [name, media_type]: [&str; 2], time_ns: u64, data: &[u8]) {
        record(&mut self.lasting, opcode::ATTACHMENT, |to| {
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
        put_metadata(&mut self.lasting, name, entries);
    }

    /// Writes what waits, messages by one call, and returns its bytes.
    ///
    /// # Errors
    /// The file cannot be written, as where the disk is full. What was flushed before stays readable.
    pub fn flush(&mut self, to: &mut impl Write) -> io::Result<usize> {
        let lasting = self.lasting.get(self.flushed..).unwrap_or_default();
        let bytes = lasting.len() + self.messages.len();
        if !lasting.is_empty() {
            to.write_all(lasting)?;
        }
        to.write_all(&self.messages)?;
        to.flush()?;
        self.flushed = self.lasting.len();
        self.messages.clear();
        Ok(bytes)
    }

    /// Ends the file, without an index, with what is said of it alone; what is flushed next begins another one. Returns its
    /// last bytes.
    ///
    /// # Errors
    /// As [`Self::flush`].
    pub fn end(
        &mut self,
        to: &mut impl Write,
        (name, entries): (&str, &[(&str, String)]),
    ) -> io::Result<usize> {
        let mut bytes = self.flush(to)?;
        let mut end = Vec::new();
        put_metadata(&mut end, name, entries);
        record(&mut end, opcode::DATA_END, |to| put_u32(to, 0));
        put_end(&mut end, 0);
        to.write_all(&end)?;
        to.flush()?;
        self.flushed = 0;
        bytes += end.len();
        Ok(bytes)
    }

    /// The messages that wait, which no file will have.
    pub(crate) fn take_messages(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.messages)
    }
}
