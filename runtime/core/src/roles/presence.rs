//! Joining and leaving.

use zerocopy::FromZeros;

use crate::wire::{ABI, Role, StatMsg};

/// Who a process is: what it puts into its messages.
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// Process id.
    pub pid: u32,
    /// First 16 bytes of the model's id.
    pub model: [u8; 16],
    /// Build of the program.
    pub build: u32,
    /// Port name, zero padded.
    pub name: [u8; 48],
}

impl Identity {
    /// The identity of process `pid` under a port name, of which 48 bytes are kept.
    pub fn new(pid: u32, name: &str) -> Self {
        let mut padded = [0; 48];
        for (to, from) in padded.iter_mut().zip(name.bytes()) {
            *to = from;
        }
        Self { pid, model: [0; 16], build: 0, name: padded }
    }

    /// First 4 bytes of the model's id.
    pub(super) fn short_model(&self) -> u32 {
        let [a, b, c, d, ..] = self.model;
        u32::from_le_bytes([a, b, c, d])
    }

    /// A status with `flags`, everything that changes left zero.
    pub(super) fn status(&self, schema: u64, role: Role, flags: u32) -> StatMsg {
        StatMsg {
            schema,
            pid: self.pid,
            role: role as u8,
            abi: ABI as u8,
            model: self.model,
            build: self.build,
            flags,
            name: self.name,
            ..StatMsg::new_zeroed()
        }
    }
}
