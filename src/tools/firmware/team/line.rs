//! The line between a relay and a device, which damages what it carries in both directions.

use std::collections::BTreeSet;

use sortie_core::link::LineCounters;

use super::channel::{Carried, Channel, Noise, Pieces, packets};
use super::counted::Counted;
use super::device::Device;
use super::port::Port;
use sortie_cli::failure::Failure;

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
