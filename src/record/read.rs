//! Reading from front to back, with chunks or without.

use std::io::{self, Read};

use lz4_flex::frame::FrameDecoder;

use crate::encode::{CHECKSUM, MAGIC, opcode};
use crate::error::RecordError;
use crate::write::Message;

/// The most bytes of a chunk, as they were before they were compressed: more than any writer gives one.
const MOST_CHUNK_BYTES: u64 = 256 << 20;

/// A part of a record.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Record<'a> {
    /// How a file begins.
    Header {
        /// What its channels hold.
        profile: &'a str,
        /// Who wrote it.
        library: &'a str,
    },
    /// How messages are laid out.
    Schema {
        /// Its number.
        id: u16,
        /// What it is called.
        name: &'a str,
        /// The language of `data`.
        encoding: &'a str,
        /// The layout.
        data: &'a [u8],
    },
    /// A channel of messages.
    Channel {
        /// Its number.
        id: u16,
        /// That of its schema.
        schema: u16,
        /// What it is called.
        topic: &'a str,
        /// How its messages are encoded.
        encoding: &'a str,
    },
    /// A message.
    Message(Message, &'a [u8]),
    /// A file that the record brings along.
    Attachment {
        /// What it is called.
        name: &'a str,
        /// What it holds.
        data: &'a [u8],
    },
    /// What is said of something.
    Metadata {
        /// Of what.
        name: &'a str,
        /// By names.
        entries: Vec<(&'a str, &'a str)>,
    },
    /// No more messages follow.
    DataEnd,
    /// Something of an index, or of a later version of the format.
    Other(u8),
}

/// A record of a file as its bytes are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Raw<'a> {
    pub(crate) opcode: u8,
    pub(crate) content: &'a [u8],
    /// Where it begins in the file; of one within a chunk, where the chunk does.
    pub(crate) at: u64,
}

/// Reads what a [`Writer`](crate::Writer) or others wrote, a record at a time.
#[derive(Debug)]
pub struct Reader<R> {
    from: R,
    /// Where the next record begins.
    at: u64,
    /// Where the last one began.
    began: u64,
    content: Vec<u8>,
    /// The footer was read.
    is_over: bool,
    /// The chunk that is being read, and how far it was.
    chunk: Vec<u8>,
    inside: usize,
}

impl<R: Read> Reader<R> {
    /// Begins to read.
    ///
    /// # Errors
    /// This is no MCAP file.
    pub fn new(mut from: R) -> Result<Self, RecordError> {
        let mut magic = Vec::new();
        from.by_ref().take(MAGIC.len() as u64).read_to_end(&mut magic)?;
        if magic != MAGIC {
            return Err(RecordError::NotARecord);
        }
        let (at, content, chunk) = (MAGIC.len() as u64, Vec::new(), Vec::new());
        Ok(Self { from, at, began: at, content, is_over: false, chunk, inside: 0 })
    }

    /// The next record; none at the end of the file. What chunks hold comes in its order.
    ///
    /// # Errors
    /// The file is cut, or broken.
    // An iterator could not lend what it read.
    #[expect(clippy::should_implement_trait, reason = "an iterator cannot lend what it has read")]
    pub fn next(&mut self) -> Result<Option<Record<'_>>, RecordError> {
        let Some(Raw { opcode, content, at }) = self.next_raw()? else { return Ok(None) };
        parse(opcode, content).ok_or(RecordError::Broken { what: name(opcode), at }).map(Some)
    }

    pub(crate) fn next_raw(&mut self) -> Result<Option<Raw<'_>>, RecordError> {
        loop {
            if self.inside < self.chunk.len() {
                let at = self.began;
                let broken = || RecordError::Broken { what: "a record of the chunk", at };
                let mut fields = Fields(&self.chunk[self.inside..]);
                let opcode = fields.u8().ok_or_else(broken)?;
                let content = fields.long_bytes().ok_or_else(broken)?;
                self.inside = self.chunk.len() - fields.0.len();
                let first = self.inside - content.len();
                let content = &self.chunk[first..self.inside];
                return Ok(Some(Raw { opcode, content, at }));
            }
            match self.read()? {
                None => return Ok(None),
                Some(opcode::CHUNK) => self.open_chunk()?,
                Some(opcode) => {
                    return Ok(Some(Raw { opcode, content: &self.content, at: self.began }));
                }
            }
        }
    }

    /// Reads a record of the file: what it is.
    fn read(&mut self) -> Result<Option<u8>, RecordError> {
        self.began = self.at;
        let torn = RecordError::Torn { at: self.at };
        let mut head = Vec::new();
        // Behind the footer stands what stands before the header.
        let most = if self.is_over { 0 } else { 9 };
        self.from.by_ref().take(most).read_to_end(&mut head)?;
        if head.is_empty() {
            return Ok(None);
        }
        let (Some(opcode), Some(length)) = (head.first(), head.get(1..9)) else {
            return Err(torn);
        };
        self.is_over = *opcode == opcode::FOOTER;
        let length = length.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte));
        self.content.clear();
        self.from.by_ref().take(length).read_to_end(&mut self.content)?;
        if self.content.len() as u64 != length {
            return Err(torn);
        }
        self.at += 9 + length;
        Ok(Some(*opcode))
    }

    fn open_chunk(&mut self) -> Result<(), RecordError> {
        let at = self.began;
        let broken = |what| RecordError::Broken { what, at };
        let head = || {
            let mut fields = Fields(&self.content);
            let (_, _) = (fields.u64()?, fields.u64()?);
            let (size, checksum) = (fields.u64()?, fields.u32()?);
            Some((size, checksum, fields.text()?, fields.long_bytes()?))
        };
        let (size, checksum, by, packed) = head().ok_or_else(|| broken("a chunk's head"))?;
        if size > MOST_CHUNK_BYTES {
            return Err(broken("a chunk's size"));
        }
        self.inside = 0;
        self.chunk.clear();
        match by {
            "" => self.chunk.extend(packed),
            "lz4" => {
                let unpacked = unpack(packed, size, &mut self.chunk);
                unpacked.map_err(|_| broken("a chunk's compression"))?;
            }
            _ => return Err(RecordError::Compression { by: by.to_owned(), at }),
        }
        let is_right = checksum == 0 || checksum == CHECKSUM.checksum(&self.chunk);
        if self.chunk.len() as u64 != size || !is_right {
            self.chunk.clear();
            return Err(broken("a chunk's content"));
        }
        Ok(())
    }
}

/// Outside of what is generic, which would be compiled where records are read, for size.
fn unpack(packed: &[u8], most: u64, chunk: &mut Vec<u8>) -> io::Result<usize> {
    FrameDecoder::new(packed).take(most).read_to_end(chunk)
}

fn name(opcode: u8) -> &'static str {
    match opcode {
        opcode::HEADER => "the header",
        opcode::SCHEMA => "a schema",
        opcode::CHANNEL => "a channel",
        opcode::MESSAGE => "a message",
        opcode::ATTACHMENT => "an attachment",
        opcode::METADATA => "metadata",
        _ => "a record",
    }
}

fn parse(opcode: u8, content: &[u8]) -> Option<Record<'_>> {
    let mut fields = Fields(content);
    Some(match opcode {
        opcode::HEADER => Record::Header { profile: fields.text()?, library: fields.text()? },
        opcode::SCHEMA => Record::Schema {
            id: fields.u16()?,
            name: fields.text()?,
            encoding: fields.text()?,
            data: fields.bytes()?,
        },
        opcode::CHANNEL => Record::Channel {
            id: fields.u16()?,
            schema: fields.u16()?,
            topic: fields.text()?,
            encoding: fields.text()?,
        },
        opcode::MESSAGE => {
            let (channel, sequence) = (fields.u16()?, fields.u32()?);
            let (log_time, publish_time) = (fields.u64()?, fields.u64()?);
            Record::Message(Message { channel, sequence, log_time, publish_time }, fields.0)
        }
        opcode::ATTACHMENT => {
            let (_, _) = (fields.u64()?, fields.u64()?);
            let (name, _, data) = (fields.text()?, fields.text()?, fields.long_bytes()?);
            let checked = &content[..content.len() - fields.0.len()];
            let checksum = fields.u32()?;
            let is_right = checksum == 0 || checksum == CHECKSUM.checksum(checked);
            is_right.then_some(Record::Attachment { name, data })?
        }
        opcode::METADATA => {
            let name = fields.text()?;
            let mut map = Fields(fields.bytes()?);
            let mut entries = Vec::new();
            while !map.0.is_empty() {
                entries.push((map.text()?, map.text()?));
            }
            Record::Metadata { name, entries }
        }
        opcode::DATA_END => Record::DataEnd,
        other => Record::Other(other),
    })
}

/// Fields of a record, one after the other; none where there are too few bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their length in 32 bits.
    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.take(length as usize)
    }

    /// Bytes behind their length in 64 bits.
    pub(crate) fn long_bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u64()?;
        self.take(usize::try_from(length).ok()?)
    }

    pub(crate) fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }
}
