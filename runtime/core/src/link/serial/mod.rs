//! A runner at the other end of a serial line: UART, USB, or anything else that carries bytes.
//!
//! Packets are postcard with a CRC-32 and COBS, between zeros: after lost, doubled or changed bytes the
//! next zero begins anew, and what was damaged is dropped and counted. [`Serial`] is the link of the
//! runner on the microcontroller, [`Relay`] stands for it in the team.
//!
//! Frames are private ones: the entities that the runner's agents see, and of their features those that
//! are not zero. What the agents decide is the same as beside the world, bit for bit.

mod agent;
mod line;
mod packet;
mod relay;
#[cfg(test)]
mod tests;
mod view;

pub use agent::Serial;
pub use line::LineCounters;
pub use relay::Relay;
pub use view::packet_bytes;
