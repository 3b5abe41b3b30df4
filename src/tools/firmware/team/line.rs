//! The line between a relay and a device, which damages what it carries in both directions.

use std::cell::RefCell;
use std::collections::{BTreeSet, VecDeque};
use std::convert::Infallible;
use std::rc::Rc;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use serde::Serialize;
use sortie_cli::failure::Failure;
use sortie_core::link::LineCounters;
use sortie_envs::random::{Random, below, stream};

use super::device::{Counted, Device};

/// The line, and the device at its end.
pub(crate) struct Line<'d> {
    device: &'d mut dyn Device,
    port: Port,
    down: Channel,
    up: Channel,
    /// What stood between zeros on the way to the device since it was switched on, and to the relay.
    to_device: Pieces,
    to_relay: Pieces,
    /// What the device counts, and what it did before it was switched off.
    counted: Counted,
    earlier: Counted,
    uncounted: u64,
    /// Episode and step from which on the device is switched off and on again.
    resets: BTreeSet<(u32, u32)>,
    done: u64,
    /// Turns that the line has had.
    turns: u64,
}

/// What became of the line.
pub(crate) struct LineReport {
    pub(crate) down: Carried,
    pub(crate) up: Carried,
    pub(crate) device: Counted,
    pub(crate) resets: u64,
    /// Pieces between zeros that one end was given and did not count.
    pub(crate) uncounted: u64,
}

impl<'d> Line<'d> {
    /// A line to a device that has just been switched on.
    pub(crate) fn new(
        device: &'d mut dyn Device,
        noise: Noise,
        resets: BTreeSet<(u32, u32)>,
    ) -> Result<Self, Failure> {
        let mut line = Self {
            device,
            port: Port::default(),
            down: Channel::new(noise, 0),
            up: Channel::new(noise, 1),
            to_device: Pieces::default(),
            to_relay: Pieces::default(),
            counted: Counted::default(),
            earlier: Counted::default(),
            uncounted: 0,
            resets,
            done: 0,
            turns: 0,
        };
        let (bytes, counted) = line.device.exchange(&[])?;
        line.receive(&bytes, counted);
        Ok(line)
    }

    /// The relay's end.
    pub(crate) fn port(&self) -> Port {
        self.port.clone()
    }

    /// Carries what the relay has sent, and what the device answers. Returns whether there was anything.
    pub(crate) fn turn(&mut self, episode: u32, step: u32) -> Result<bool, Failure> {
        let sent = self.port.take();
        if sent.is_empty() {
            return Ok(false);
        }
        self.turns += 1;
        let mut arrives = Vec::new();
        for (index, packet) in sent.iter().enumerate() {
            arrives.extend(self.down.carry(packet, (self.turns, index)));
        }
        let (bytes, counted) = if self.is_due(episode, step) {
            self.settle();
            self.done += 1;
            self.device.restart(&arrives)?
        } else {
            self.to_device.add(&arrives);
            self.device.exchange(&arrives)?
        };
        self.receive(&bytes, counted);
        Ok(true)
    }

    fn is_due(&mut self, episode: u32, step: u32) -> bool {
        let is_due = self.resets.first().is_some_and(|first| *first <= (episode, step));
        is_due && self.resets.pop_first().is_some()
    }

    fn receive(&mut self, bytes: &[u8], counted: Counted) {
        self.counted = counted;
        for (index, packet) in packets(bytes).enumerate() {
            let arrives = self.up.carry(packet, (self.turns, index));
            self.to_relay.add(&arrives);
            self.port.bring(&arrives);
        }
    }

    /// The device is switched off: what it has counted is settled.
    fn settle(&mut self) {
        let counted = std::mem::take(&mut self.counted);
        let given = std::mem::take(&mut self.to_device).ended;
        self.uncounted += given.abs_diff(counted.pieces());
        self.earlier.add(counted);
    }

    /// The end of the line, at which the relay has counted so much.
    pub(crate) fn close(mut self, relay: &LineCounters) -> LineReport {
        self.settle();
        let taken = relay.packets + relay.damaged();
        LineReport {
            down: self.down.carried,
            up: self.up.carried,
            device: self.earlier,
            resets: self.done,
            uncounted: self.uncounted + self.to_relay.ended.abs_diff(taken),
        }
    }
}

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

/// One end of a line: what is written goes, packet by packet, and what has come is read. Copies are the same end.
#[derive(Clone, Debug, Default)]
pub(crate) struct Port(Rc<RefCell<Ends>>);

#[derive(Debug, Default)]
struct Ends {
    begun: Vec<u8>,
    goes: Vec<Vec<u8>>,
    comes: VecDeque<u8>,
}

impl Port {
    /// The packets that were written since the last call.
    pub(crate) fn take(&self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.0.borrow_mut().goes)
    }

    /// Bytes come.
    pub(crate) fn bring(&self, bytes: &[u8]) {
        self.0.borrow_mut().comes.extend(bytes);
    }
}

impl ErrorType for Port {
    type Error = Infallible;
}

impl Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let comes = &mut self.0.borrow_mut().comes;
        let len = comes.len().min(bytes.len());
        bytes.iter_mut().zip(comes.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().comes.is_empty())
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.borrow_mut().begun.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        let mut ends = self.0.borrow_mut();
        let packet = std::mem::take(&mut ends.begun);
        ends.goes.push(packet);
        Ok(())
    }
}
