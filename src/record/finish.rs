//! Mending and indexing: what was written as it happened becomes chunks, compressed, with an index behind them.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

use crate::encode::{
    CHECKSUM, MAGIC, list, opcode, put_end, put_text, put_u16, put_u32, put_u64, record,
};
use crate::error::RecordError;
use crate::read::{Fields, Raw, Reader};

/// Bytes of messages that are compressed together.
const CHUNK_BYTES: usize = 1 << 20;

/// What became of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Finished {
    /// Its messages.
    pub messages: u64,
    /// As many of them by channel.
    pub by_channel: BTreeMap<u16, u64>,
    /// Its bytes before.
    pub bytes_before: u64,
    /// Its bytes now.
    pub bytes: u64,
    /// Where it had been cut off, if it was.
    pub torn_at: Option<u64>,
    /// It had been finished before, and stays as it is.
    pub was_finished: bool,
}

/// Gives a record chunks and an index, in its place. What is behind the first torn record is lost, all before it is kept.
///
/// # Errors
/// The file cannot be read or written, or is broken otherwise than by being cut off; it stays as it is.
pub fn finish(path: &Path) -> Result<Finished, RecordError> {
    let mut file = File::open(path)?;
    let bytes_before = file.metadata()?.len();
    if has_index(&mut file)? {
        let (bytes, was_finished) = (bytes_before, true);
        return Ok(Finished { bytes_before, bytes, was_finished, ..Finished::default() });
    }
    let mut name = OsString::from(path);
    name.push(".finishing");
    let result = write_anew(&mut Reader::new(BufReader::new(file))?, Path::new(&name));
    let finished = result.and_then(|finished| {
        fs::rename(&name, path)?;
        Ok(Finished { bytes_before, ..finished })
    });
    if finished.is_err() {
        // What is there already is of no use to anybody.
        let _ = fs::remove_file(&name);
    }
    finished
}

/// Whether a file ends with an index.
fn has_index(file: &mut File) -> Result<bool, RecordError> {
    // What every footer is: its kind and length, where the index begins, two more numbers, and the last bytes.
    let mut end = [0; 1 + 8 + 8 + 8 + 4 + MAGIC.len()];
    let is_long = file.seek(SeekFrom::End(-(end.len() as i64))).is_ok();
    let is_read = is_long && file.read_exact(&mut end).is_ok();
    file.rewind()?;
    let is_footer = end[0] == opcode::FOOTER && end.ends_with(&MAGIC);
    Ok(is_read && is_footer && end[9..17] != [0; 8])
}

fn write_anew(reader: &mut Reader<BufReader<File>>, to: &Path) -> Result<Finished, RecordError> {
    let mut out = Chunks::new(File::create(to)?)?;
    let torn_at = loop {
        match reader.next_raw() {
            Ok(Some(raw)) if raw.opcode == opcode::DATA_END => break None,
            Ok(Some(raw)) => out.add(raw)?,
            Ok(None) => break None,
            Err(RecordError::Torn { at }) => break Some(at),
            Err(other) => return Err(other),
        }
    };
    let (by_channel, bytes) = out.end()?;
    let messages = by_channel.values().sum();
    Ok(Finished { messages, by_channel, bytes, torn_at, ..Finished::default() })
}

/// Where a record stands in the file.
#[derive(Clone, Copy, Debug)]
struct Place {
    at: u64,
    bytes: u64,
}

/// The chunk that is being filled.
#[derive(Debug, Default)]
struct Chunk {
    records: Vec<u8>,
    /// By channels: when each message was recorded, and where in the chunk it begins.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
    times: Times,
}

/// The first and the last time of messages.
#[derive(Clone, Copy, Debug, Default)]
struct Times(Option<(u64, u64)>);

impl Times {
    fn add(&mut self, time: u64) {
        let (first, last) = self.0.unwrap_or((time, time));
        self.0 = Some((first.min(time), last.max(time)));
    }

    fn put(self, to: &mut Vec<u8>) {
        let (first, last) = self.0.unwrap_or_default();
        put_u64(to, first);
        put_u64(to, last);
    }
}

/// A file of chunks, and what its index will say.
struct Chunks {
    to: File,
    written: u64,
    chunk: Chunk,
    /// Schemas and channels, which the index repeats.
    known: Vec<u8>,
    schemas: u16,
    channels: u32,
    /// Indexes of chunks, attachments and metadata.
    index: Vec<u8>,
    /// How many of them there are.
    indexed: [u32; 3],
    /// By channels.
    messages: BTreeMap<u16, u64>,
    times: Times,
}

impl Chunks {
    fn new(to: File) -> Result<Self, RecordError> {
        let mut chunks = Self {
            to,
            written: 0,
            chunk: Chunk::default(),
            known: Vec::new(),
            schemas: 0,
            channels: 0,
            index: Vec::new(),
            indexed: [0; 3],
            messages: BTreeMap::new(),
            times: Times::default(),
        };
        chunks.write(&MAGIC)?;
        Ok(chunks)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<Place, RecordError> {
        self.to.write_all(bytes)?;
        let place = Place { at: self.written, bytes: bytes.len() as u64 };
        self.written += place.bytes;
        Ok(place)
    }

    fn add(&mut self, raw: Raw<'_>) -> Result<(), RecordError> {
        match raw.opcode {
            opcode::MESSAGE => return self.add_message(raw),
            opcode::HEADER
            | opcode::SCHEMA
            | opcode::CHANNEL
            | opcode::ATTACHMENT
            | opcode::METADATA => {}
            // The old index, and what nobody here knows.
            _ => return Ok(()),
        }
        // Everything keeps its place among the messages.
        self.end_chunk()?;
        let mut bytes = Vec::new();
        record(&mut bytes, raw.opcode, |to| to.extend(raw.content));
        let place = self.write(&bytes)?;
        match raw.opcode {
            opcode::SCHEMA => self.schemas += 1,
            opcode::CHANNEL => self.channels += 1,
            opcode::ATTACHMENT => return self.index_attachment(raw, place),
            opcode::METADATA => return self.index_metadata(raw, place),
            _ => return Ok(()),
        }
        self.known.extend(bytes);
        Ok(())
    }

    fn add_message(&mut self, raw: Raw<'_>) -> Result<(), RecordError> {
        let mut fields = Fields(raw.content);
        let mut head = || Some((fields.u16()?, fields.u32()?, fields.u64()?));
        let broken = RecordError::Broken { what: "a message", at: raw.at };
        let (channel, _, time) = head().ok_or(broken)?;
        let Chunk { records, index, times } = &mut self.chunk;
        index.entry(channel).or_default().push((time, records.len() as u64));
        times.add(time);
        self.times.add(time);
        *self.messages.entry(channel).or_default() += 1;
        record(records, raw.opcode, |to| to.extend(raw.content));
        if records.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    fn end_chunk(&mut self) -> Result<(), RecordError> {
        let Chunk { records, index, times } = std::mem::take(&mut self.chunk);
        if records.is_empty() {
            return Ok(());
        }
        // Readers make room for a whole block before they read it: of the usual 4 MiB that takes longer than what is in it.
        let blocks = FrameInfo::new().block_size(BlockSize::Max256KB);
        let mut packer = FrameEncoder::with_frame_info(blocks, Vec::new());
        packer.write_all(&records)?;
        let packed = packer.finish().map_err(std::io::Error::from)?;
        let mut bytes = Vec::new();
        record(&mut bytes, opcode::CHUNK, |to| {
            times.put(to);
            put_u64(to, records.len() as u64);
            put_u32(to, CHECKSUM.checksum(&records));
            put_text(to, "lz4");
            put_u64(to, packed.len() as u64);
            to.extend(&packed);
        });
        let place = self.write(&bytes)?;
        let mut bytes = Vec::new();
        let mut indexes = Vec::new();
        for (channel, messages) in &index {
            indexes.push((*channel, self.written + bytes.len() as u64));
            record(&mut bytes, opcode::MESSAGE_INDEX, |to| {
                put_u16(to, *channel);
                list(to, |to| {
                    for (time, at) in messages {
                        put_u64(to, *time);
                        put_u64(to, *at);
                    }
                });
            });
        }
        let index = self.write(&bytes)?;
        record(&mut self.index, opcode::CHUNK_INDEX, |to| {
            times.put(to);
            put_u64(to, place.at);
            put_u64(to, place.bytes);
            list(to, |to| {
                for (channel, at) in &indexes {
                    put_u16(to, *channel);
                    put_u64(to, *at);
                }
            });
            put_u64(to, index.bytes);
            put_text(to, "lz4");
            put_u64(to, packed.len() as u64);
            put_u64(to, records.len() as u64);
        });
        self.indexed[0] += 1;
        Ok(())
    }

    fn index_attachment(&mut self, raw: Raw<'_>, place: Place) -> Result<(), RecordError> {
        let read = || {
            let mut fields = Fields(raw.content);
            let times = [fields.u64()?, fields.u64()?];
            Some((times, fields.text()?, fields.text()?, fields.long_bytes()?.len()))
        };
        let broken = RecordError::Broken { what: "an attachment", at: raw.at };
        let ([logged, created], name, media_type, bytes) = read().ok_or(broken)?;
        record(&mut self.index, opcode::ATTACHMENT_INDEX, |to| {
            for value in [place.at, place.bytes, logged, created, bytes as u64] {
                put_u64(to, value);
            }
            put_text(to, name);
            put_text(to, media_type);
        });
        self.indexed[1] += 1;
        Ok(())
    }

    fn index_metadata(&mut self, raw: Raw<'_>, place: Place) -> Result<(), RecordError> {
        let broken = RecordError::Broken { what: "metadata", at: raw.at };
        let name = Fields(raw.content).text().ok_or(broken)?;
        record(&mut self.index, opcode::METADATA_INDEX, |to| {
            put_u64(to, place.at);
            put_u64(to, place.bytes);
            put_text(to, name);
        });
        self.indexed[2] += 1;
        Ok(())
    }

    /// Writes the index: how many messages there are of each channel, and bytes of the file.
    fn end(mut self) -> Result<(BTreeMap<u16, u64>, u64), RecordError> {
        self.end_chunk()?;
        let mut bytes = Vec::new();
        record(&mut bytes, opcode::DATA_END, |to| put_u32(to, 0));
        let begins = self.written + bytes.len() as u64;
        bytes.extend(&self.known);
        let messages = self.messages.values().sum();
        let [chunks, attachments, metadata] = self.indexed;
        record(&mut bytes, opcode::STATISTICS, |to| {
            put_u64(to, messages);
            put_u16(to, self.schemas);
            for count in [self.channels, attachments, metadata, chunks] {
                put_u32(to, count);
            }
            self.times.put(to);
            list(to, |to| {
                for (channel, messages) in &self.messages {
                    put_u16(to, *channel);
                    put_u64(to, *messages);
                }
            });
        });
        bytes.extend(&self.index);
        put_end(&mut bytes, begins);
        self.write(&bytes)?;
        self.to.sync_all()?;
        Ok((self.messages, self.written))
    }
}
