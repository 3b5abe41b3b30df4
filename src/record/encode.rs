//! How records are laid out: numbers are little-endian, texts and maps have their length before them.

use crc::{CRC_32_ISO_HDLC, Crc, Table};

/// First and last bytes of a file.
pub(crate) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// The checksum of the format, 16 bytes at a time: byte by byte it is a quarter of what it takes to make a record again.
pub(crate) static CHECKSUM: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// What a record is, by its first byte.
pub(crate) mod opcode {
    pub(crate) const HEADER: u8 = 1;
    pub(crate) const FOOTER: u8 = 2;
    pub(crate) const SCHEMA: u8 = 3;
    pub(crate) const CHANNEL: u8 = 4;
    pub(crate) const MESSAGE: u8 = 5;
    pub(crate) const CHUNK: u8 = 6;
    pub(crate) const MESSAGE_INDEX: u8 = 7;
    pub(crate) const CHUNK_INDEX: u8 = 8;
    pub(crate) const ATTACHMENT: u8 = 9;
    pub(crate) const ATTACHMENT_INDEX: u8 = 10;
    pub(crate) const STATISTICS: u8 = 11;
    pub(crate) const METADATA: u8 = 12;
    pub(crate) const METADATA_INDEX: u8 = 13;
    pub(crate) const DATA_END: u8 = 15;
}

/// Adds a record, whose content `fill` writes.
pub(crate) fn record(to: &mut Vec<u8>, opcode: u8, fill: impl FnOnce(&mut Vec<u8>)) {
    to.push(opcode);
    let length = reserve::<8>(to);
    fill(to);
    patch(to, length, |bytes| (bytes as u64).to_le_bytes());
}

/// Room for the length of what is added next.
fn reserve<const N: usize>(to: &mut Vec<u8>) -> usize {
    to.extend([0; N]);
    to.len()
}

/// Writes how many bytes were added since the length before `first` was reserved.
fn patch<const N: usize>(to: &mut [u8], first: usize, length: impl FnOnce(usize) -> [u8; N]) {
    let length = length(to.len() - first);
    to[first - N..first].copy_from_slice(&length);
}

pub(crate) fn put_u16(to: &mut Vec<u8>, value: u16) {
    to.extend(value.to_le_bytes());
}

pub(crate) fn put_u32(to: &mut Vec<u8>, value: u32) {
    to.extend(value.to_le_bytes());
}

pub(crate) fn put_u64(to: &mut Vec<u8>, value: u64) {
    to.extend(value.to_le_bytes());
}

/// Bytes behind their length, cut to what 32 bits count.
pub(crate) fn put_bytes(to: &mut Vec<u8>, bytes: &[u8]) {
    list(to, |to| to.extend(&bytes[..bytes.len().min(u32::MAX as usize)]));
}

pub(crate) fn put_text(to: &mut Vec<u8>, text: &str) {
    put_bytes(to, text.as_bytes());
}

/// What `fill` adds, behind its length in 32 bits.
pub(crate) fn list(to: &mut Vec<u8>, fill: impl FnOnce(&mut Vec<u8>)) {
    let first = reserve::<4>(to);
    fill(to);
    patch(to, first, |bytes| (bytes as u32).to_le_bytes());
}

pub(crate) fn put_map(to: &mut Vec<u8>, entries: &[(&str, String)]) {
    list(to, |to| {
        for (key, value) in entries {
            put_text(to, key);
            put_text(to, value);
        }
    });
}

pub(crate) fn put_metadata(to: &mut Vec<u8>, name: &str, entries: &[(&str, String)]) {
    record(to, opcode::METADATA, |to| {
        put_text(to, name);
        put_map(to, entries);
    });
}

pub(crate) fn put_header(to: &mut Vec<u8>, profile: &str, library: &str) {
    record(to, opcode::HEADER, |to| {
        put_text(to, profile);
        put_text(to, library);
    });
}

/// Where the index of a file begins, 0 where there is none, and the end of the file.
pub(crate) fn put_end(to: &mut Vec<u8>, index: u64) {
    record(to, opcode::FOOTER, |to| {
        put_u64(to, index);
        put_u64(to, 0);
        put_u32(to, 0);
    });
    to.extend(MAGIC);
}
