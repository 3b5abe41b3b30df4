//! A line between two hosts, for the runner of some agents that is elsewhere than its team.
//!
//! The team's end, [`Home`], stands by a [`Relay`](sortie_core::link::Relay), the runner's end, [`Away`], by a
//! [`Serial`](sortie_core::link::Serial): what goes over a serial line goes over a [`Carrier`], a datagram for all that is said at
//! once: over [`Udp`], or over what somebody else brings. Datagrams get lost, come twice, or late. Each carries the session that both ends agreed on, a number, and a checksum
//! that nobody can make without the [`Key`]: what is of another session, or not newer than all before, is dropped, so that
//! nothing old is ever acted upon.
//!
//! Nobody is led or locked across the line: the team's end holds the seats, and a cut leaves them with it. The runner's end only
//! computes.
//!
//! Both ends know the secret, and what is said is not secret: whoever can read the line sees what agents see. Where that
//! matters, the line belongs into a tunnel.
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//!
//! use embedded_io::{Read, ReadReady, Write};
//! use sortie_core::Shape;
//! use sortie_line::{Away, Home, Key, LineSettings, Offer, Team, Udp};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let shape = Shape { agents: 5, entities: 11, tasks: 6, actions: 13, features: 58 };
//! let team = Team::new(shape, 10_000_000, 4);
//! let wanted = Offer { abi: 3, contract: 1, model: [7; 16], agents: 0b11000 };
//! let judge = move |offer: &Offer| match *offer == wanted {
//!     true => Ok(team),
//!     false => Err("it is another runner".to_owned()),
//! };
//! let listening = Arc::new(Udp::listen("127.0.0.1:0".parse()?)?);
//! let address = listening.own_address()?;
//! let settings = LineSettings { carrier: listening, key: Key::plain(), copies: 1 };
//! let home = Home::open(settings.clone(), judge, || ())?;
//!
//! // On the other host.
//! let patience = Duration::from_secs(5);
//! let settings = LineSettings { carrier: Arc::new(Udp::connect(address)?), ..settings };
//! let taken = Away::connect(settings, wanted, patience, &|| false)?;
//! assert_eq!(taken.team.shape(), shape);
//! let mut line = taken.line;
//! line.write_all(b"an answer")?;
//! line.send();
//!
//! // At home, once it is woken.
//! let mut port = home.port();
//! while !port.read_ready()? {}
//! let mut heard = [0; 9];
//! port.read_exact(&mut heard).map_err(|_| "it was cut short")?;
//! assert_eq!(&heard, b"an answer");
//! # Ok(())
//! # }
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod allocator;
mod away;
mod carrier;
mod datagram;
mod home;
mod joining;
mod key;
mod runner;
#[cfg(test)]
mod tests;

use std::sync::Arc;

pub use allocator::{AllocatorAtHome, FarAllocator};
pub use away::{Away, Rest};
pub use carrier::{Carrier, Hear, Udp};
pub use datagram::{Offer, Team};
pub use home::{Home, HomePort};
pub use joining::{Joining, Taken};
pub use key::{Key, KeyError};
pub use runner::{FarPoll, FarRunner};

/// What both ends of a line are opened with.
#[derive(Clone)]
pub struct LineSettings {
    /// What carries its datagrams.
    pub carrier: Arc<dyn Carrier>,
    /// The secret of both.
    pub key: Key,
    /// How often everything is said, for lines that lose much.
    pub copies: usize,
}

/// Why a line is not opened.
#[derive(Debug, thiserror::Error)]
pub enum LineError {
    /// What carries it failed.
    #[error("the line to {address} fails: {source}")]
    Carrier {
        /// Where it goes, or where it listens.
        address: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// Nobody with the key has answered.
    #[error(
        "nobody answers at {address}: is the team up, with `--listen` there, and is the key the same?"
    )]
    NoAnswer {
        /// Where it goes.
        address: String,
    },
    /// Another runner acts for these agents, and goes on.
    #[error("another runner acts for these agents of the team at {address}")]
    Busy {
        /// Where it goes.
        address: String,
    },
    /// The team does not take this runner.
    #[error("the team at {address} refuses: {reason}")]
    Refused {
        /// Where it goes.
        address: String,
        /// In its words.
        reason: String,
    },
    /// Somebody asked to stop.
    #[error("interrupted")]
    Interrupted,
}
