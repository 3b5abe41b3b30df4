//! How the process that reads networks may end.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How a process ended that gave no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Ending {
    /// It asked for more memory than it may have.
    Memory {
        /// The limit in MiB.
        limit_mib: u32,
    },
    /// It used its processor time up.
    Time {
        /// The limit in seconds.
        limit_s: u32,
    },
    /// It gave no answer in time.
    Silent {
        /// The limit in seconds.
        limit_s: u32,
    },
    /// Its stack overflowed.
    Stack,
    /// A signal ended it.
    Signal(i32),
    /// It ended by itself with this code; 101 is a panic.
    Code(i32),
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Memory { limit_mib } => write!(f, "it takes more than {limit_mib} MiB of memory"),
            Self::Time { limit_s } => write!(f, "it takes more than {limit_s} s of processor time"),
            Self::Silent { limit_s } => write!(f, "there was no answer for {limit_s} s"),
            Self::Stack => write!(f, "its parts are nested too deeply"),
            Self::Signal(signal) => write!(f, "signal {signal} ended the process that read it"),
            Self::Code(code) => write!(f, "the process that read it ended with code {code}"),
        }
    }
}
