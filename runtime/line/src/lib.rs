//! A line between two hosts, for the runner of some agents that is elsewhere than its team.
//!
//! The team's end, [`Home`], stands by a [`Relay`](sortie_core::link::Relay), the runner's end, [`Away`], by a
//! [`Serial`](sortie_core::link::Serial): what goes over a serial line goes over a socket, a datagram for all that is said at
//! once. Datagrams get lost, come twice, or late. Each carries the session that both ends agreed on, a number, and a checksum
//! that nobody can make without the [`Key`]: what is of another session, or not newer than all before, is dropped, so that
//! nothing old is ever acted upon.
//!
//! Nobody is led or locked across the line: the team's end holds the seats, and a cut leaves them with it. The runner's end only
//! computes.
//!
//! Both ends know the secret, and what is said is not secret: whoever can read the line sees what agents see. Where that
//! matters, the line belongs into a tunnel.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod away;
mod datagram;
mod home;
mod key;
mod session;
#[cfg(test)]
mod tests;

pub use away::{Away, Rest, Taken};
pub use datagram::{Offer, Team};
pub use home::{Home, HomePort};
pub use key::{Key, KeyError};

/// Why a line is not opened.
#[derive(Debug, thiserror::Error)]
pub enum LineError {
    /// The socket failed.
    #[error("the line to {address} fails: {source}")]
    Socket {
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
