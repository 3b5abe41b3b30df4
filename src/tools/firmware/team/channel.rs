//! A serial line that damages what it carries, by a seed.

use serde::Serialize;
use sortie_envs::random::{Random, below, stream};

/// What is done to bytes and packets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Noise {
    pub(crate) seed: u64,
    /// One byte in so many is changed, lost or doubled; 0 = none.
    pub(crate) bytes: u32,
    /// One packet in so many is torn, repeated, or comes after the next; 0 = none.
    pub(crate) packets: u32,
}

/// One direction of a line.
#[derive(Debug)]
pub(crate) struct Channel {
    noise: Noise,
    /// Which of the generators of the seed.
    direction: u64,
    /// The packet before, for one that comes once more.
    last: Vec<u8>,
    /// What comes after the next packet.
    held: Vec<u8>,
    pub(crate) carried: Carried,
}

/// What a line has carried, and done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Carried {
    pub(crate) packets: u64,
    pub(crate) bytes: u64,
    pub(crate) changed: u64,
    pub(crate) lost: u64,
    pub(crate) doubled: u64,
    pub(crate) torn: u64,
    pub(crate) repeated: u64,
    pub(crate) overtaken: u64,
}

impl Channel {
    pub(crate) fn new(noise: Noise, direction: u64) -> Self {
        Self { noise, direction, last: Vec::new(), held: Vec::new(), carried: Carried::default() }
    }

    /// What arrives of a packet, and of one that waited for it. The draws are those of its place: a device that says
    /// something more in one turn changes nothing in the next.
    pub(crate) fn carry(&mut self, packet: &[u8], (turn, index): (u64, usize)) -> Vec<u8> {
        let place = turn << 16 | index as u64;
        let mut random = stream(self.noise.seed, self.direction, place);
        self.carried.packets += 1;
        self.carried.bytes += packet.len() as u64;
        let waited = std::mem::take(&mut self.held);
        let mut arrives = self.disorder(packet, &mut random);
        arrives.extend(waited);
        self.last = packet.to_vec();
        self.damage(arrives, &mut random)
    }

    /// Tears a packet, repeats it and the one before, or holds it back.
    fn disorder(&mut self, packet: &[u8], random: &mut Random) -> Vec<u8> {
        let Self { noise, last, held, carried, .. } = self;
        if noise.packets == 0 || below(random, noise.packets as usize) != 0 {
            return packet.to_vec();
        }
        match below(random, 3) {
            0 => {
                carried.torn += 1;
                packet.iter().copied().take(below(random, packet.len().max(1))).collect()
            }
            1 => {
                carried.repeated += 1 + u64::from(!last.is_empty());
                [last, packet, packet].concat()
            }
            _ => {
                carried.overtaken += 1;
                *held = packet.to_vec();
                Vec::new()
            }
        }
    }

    /// Changes, loses and doubles bytes.
    fn damage(&mut self, bytes: Vec<u8>, random: &mut Random) -> Vec<u8> {
        let Self { noise, carried, .. } = self;
        if noise.bytes == 0 {
            return bytes;
        }
        let mut arrives = Vec::with_capacity(bytes.len());
        for byte in bytes {
            if below(random, noise.bytes as usize) != 0 {
                arrives.push(byte);
                continue;
            }
            match below(random, 3) {
                0 => {
                    carried.changed += 1;
                    arrives.push(byte ^ (1 + below(random, 255)) as u8);
                }
                1 => carried.lost += 1,
                _ => {
                    carried.doubled += 1;
                    arrives.extend([byte, byte]);
                }
            }
        }
        arrives
    }
}

/// Counts what stands between zeros, over all the bytes that have come.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pieces {
    pub(crate) ended: u64,
    is_open: bool,
}

impl Pieces {
    pub(crate) fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.ended += u64::from(byte == 0 && self.is_open);
            self.is_open = byte != 0;
        }
    }
}

/// The packets of bytes that a device has sent: each ends with a zero behind its content.
pub(crate) fn packets(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        let content = rest.iter().position(|byte| *byte != 0)?;
        let end = rest.iter().skip(content).position(|byte| *byte == 0);
        let (packet, after) = rest.split_at(end.map_or(rest.len(), |end| content + end + 1));
        rest = after;
        Some(packet)
    })
}
