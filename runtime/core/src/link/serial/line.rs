//! Packets on a line of bytes: COBS between zeros, with a checksum. After noise the next zero begins
//! anew.

use cobs::{DecodeResult, DecoderState};
use embedded_io::{Read, ReadReady, Write};

use crate::checksum::crc32c;
use crate::link::Clock;

/// Bytes of a packet's checksum.
pub(super) const CHECKSUM: usize = 4;
/// Bytes that are read at once.
const CHUNK: usize = 64;
/// Most reads before the caller gets to do something else, so that noise does not hold it up.
const READS: usize = 4_096;
/// Most bytes in a row that COBS sends as they are.
const LONGEST_RUN: usize = 254;

/// What came over a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineCounters {
    /// Packets with a right checksum.
    pub packets: u64,
    /// What stood between two zeros and ended before it was whole.
    pub torn: u64,
    /// What was whole, and whose checksum was another.
    pub corrupt: u64,
    /// What was longer than there is room.
    pub too_long: u64,
    /// Packets with content that does not exist in the domain.
    pub refused: u64,
    /// Frames that came behind a newer one, or once more, while that one waited to be looked at.
    pub overtaken: u64,
}

impl LineCounters {
    /// What was no packet.
    pub fn damaged(&self) -> u64 {
        self.torn + self.corrupt + self.too_long
    }
}

/// Why what stands between two zeros is no packet, before its checksum is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flaw {
    Torn,
    TooLong,
}

/// The line failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Broken;

pub(super) struct Line<IO, P> {
    io: IO,
    chunk: [u8; CHUNK],
    /// The bytes of `chunk` that have not been looked at.
    unread: (usize, usize),
    decoder: DecoderState,
    packet: P,
    len: usize,
    /// When the first byte of the packet was seen.
    started_ns: Option<u64>,
    flaw: Option<Flaw>,
    pub(super) counters: LineCounters,
}

impl<IO: Read + ReadReady + Write, P: AsMut<[u8]>> Line<IO, P> {
    /// `packet` has room for the longest packet, and its checksum, that is to be received.
    pub(super) fn new(io: IO, packet: P) -> Self {
        Self {
            io,
            chunk: [0; CHUNK],
            unread: (0, 0),
            decoder: DecoderState::Idle,
            packet,
            len: 0,
            started_ns: None,
            flaw: None,
            counters: LineCounters::default(),
        }
    }

    /// The next whole packet of what has arrived, without its checksum, and when it began.
    pub(super) fn receive(&mut self, clock: &dyn Clock) -> Result<Option<(&[u8], u64)>, Broken> {
        for _ in 0..READS {
            while let Some(byte) = self.next_byte() {
                if let Some((len, started_ns)) = self.feed(byte, clock) {
                    let packet = self.packet.as_mut().get(..len);
                    return Ok(packet.map(|packet| (packet, started_ns)));
                }
            }
            if !self.io.read_ready().map_err(|_| Broken)? {
                return Ok(None);
            }
            let len = self.io.read(&mut self.chunk).map_err(|_| Broken)?;
            if len == 0 {
                return Ok(None);
            }
            self.unread = (0, len);
        }
        Ok(None)
    }

    fn next_byte(&mut self) -> Option<u8> {
        let (at, end) = self.unread;
        let byte = self.chunk.get(at).copied().filter(|_| at < end)?;
        self.unread.0 += 1;
        Some(byte)
    }

    /// Takes one byte. Returns the length of a packet that ends with it, and when it began.
    fn feed(&mut self, byte: u8, clock: &dyn Clock) -> Option<(usize, u64)> {
        if byte != 0 && self.started_ns.is_none() {
            self.started_ns = Some(clock.now_ns());
        }
        match self.decoder.feed(byte) {
            Ok(DecodeResult::DataContinue(byte)) => match self.packet.as_mut().get_mut(self.len) {
                Some(place) => {
                    *place = byte;
                    self.len += 1;
                }
                None => self.flaw = Some(Flaw::TooLong),
            },
            Ok(DecodeResult::NoData | DecodeResult::DataComplete) => {}
            // What is too long stays so, whatever ends it.
            Err(_) => self.flaw = self.flaw.or(Some(Flaw::Torn)),
        }
        // A zero ends everything; between two zeros in a row there is nothing.
        if byte == 0 { self.end() } else { None }
    }

    fn end(&mut self) -> Option<(usize, u64)> {
        let len = core::mem::take(&mut self.len);
        let flaw = self.flaw.take();
        let started_ns = self.started_ns.take()?;
        let packet = self.packet.as_mut().get(..len).unwrap_or_default();
        let counters = &mut self.counters;
        let refused = match (flaw, packet.split_last_chunk::<CHECKSUM>()) {
            (Some(Flaw::TooLong), _) => &mut counters.too_long,
            (Some(Flaw::Torn), _) | (None, None) => &mut counters.torn,
            (None, Some((body, sum))) if crc32c(body) == u32::from_le_bytes(*sum) => {
                counters.packets += 1;
                return Some((body.len(), started_ns));
            }
            (None, Some(_)) => &mut counters.corrupt,
        };
        *refused += 1;
        None
    }

    /// Sends a packet that carries its checksum. Takes as long as the line does.
    pub(super) fn send(&mut self, packet: &[u8]) -> Result<(), Broken> {
        // The first zero ends what noise may have begun.
        self.write(&[0])?;
        let mut rest = packet;
        loop {
            let run = rest.iter().take(LONGEST_RUN).take_while(|byte| **byte != 0).count();
            let (bytes, after) = rest.split_at_checked(run).ok_or(Broken)?;
            // A run is shorter than a byte can count.
            self.write(&[run as u8 + 1])?;
            self.write(bytes)?;
            rest = match after {
                [] => break,
                after if run == LONGEST_RUN => after,
                [_zero, after @ ..] => after,
            };
        }
        self.write(&[0])?;
        self.io.flush().map_err(|_| Broken)
    }

    fn write(&mut self, mut bytes: &[u8]) -> Result<(), Broken> {
        while !bytes.is_empty() {
            let written = self.io.write(bytes).map_err(|_| Broken)?;
            bytes = bytes.get(written..).filter(|_| written > 0).ok_or(Broken)?;
        }
        Ok(())
    }
}
