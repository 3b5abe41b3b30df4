//! An episode as bytes: version, steps, return, then a byte per cell and a bit per member.

use alloc::vec::Vec;
use core::fmt;

use super::parameters::Parameters;
use super::ring::{Ring, all_agents, member_bytes};

/// The version of the layout.
const LAYOUT: u8 = 1;
/// Bytes before the cells: the layout, the steps, the return.
const HEAD: usize = 1 + 4 + 8;

/// Bytes that do not hold a state of this ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StateError {
    /// Another layout than this program's.
    Layout {
        /// The layout of the bytes.
        found: u8,
    },
    /// Another number of bytes than this ring's states have.
    Length {
        /// The bytes given.
        found: usize,
        /// The bytes of a state.
        expected: usize,
    },
    /// More steps than an episode has.
    Steps(u32),
    /// A return that is no number.
    Return,
    /// An agent on a cell that the ring does not have.
    Cell {
        /// The agent.
        agent: usize,
        /// Its cell.
        cell: u8,
    },
    /// A group with a member that is no agent.
    Member {
        /// The group.
        group: usize,
    },
    /// An agent without a group.
    NoGroup {
        /// The agent.
        agent: usize,
    },
}

impl fmt::Display for StateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Layout { found } => write!(
                f,
                "the state of a ring has layout {found}; this program reads layout {LAYOUT}"
            ),
            Self::Length { found, expected } => {
                write!(f, "the state of a ring has {found} bytes instead of {expected}")
            }
            Self::Steps(steps) => {
                write!(f, "the state of a ring is {steps} steps into its episode: beyond the limit")
            }
            Self::Return => f.write_str("the state of a ring has a return that is no number"),
            Self::Cell { agent, cell } => {
                write!(f, "the state of a ring has agent {agent} on cell {cell}: there is none")
            }
            Self::Member { group } => {
                write!(f, "the state of a ring has a member of group {group} that is no agent")
            }
            Self::NoGroup { agent } => {
                write!(f, "the state of a ring has agent {agent} without a group")
            }
        }
    }
}

impl core::error::Error for StateError {}

/// What the bytes of a state say.
#[derive(Clone, Copy, Debug)]
pub(super) struct State<'a> {
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) ring: Ring<'a>,
}

/// Bytes of a state of such a ring.
pub fn state_bytes(parameters: &Parameters) -> usize {
    HEAD + parameters.agents + parameters.groups * member_bytes(parameters.agents)
}

impl<'a> State<'a> {
    /// Adds the bytes of this state.
    pub(super) fn write(self, bytes: &mut Vec<u8>) {
        bytes.push(LAYOUT);
        bytes.extend_from_slice(&self.steps.to_le_bytes());
        bytes.extend_from_slice(&self.episode_return.to_le_bytes());
        bytes.extend_from_slice(self.ring.cells);
        bytes.extend_from_slice(self.ring.members);
    }

    /// Reads what [`write`](Self::write) wrote for the same ring; nothing is checked but the length.
    pub(super) fn read(parameters: &Parameters, bytes: &'a [u8]) -> Result<Self, StateError> {
        let expected = state_bytes(parameters);
        let length = StateError::Length { found: bytes.len(), expected };
        let (layout, bytes) = bytes.split_first().ok_or(length)?;
        if *layout != LAYOUT {
            return Err(StateError::Layout { found: *layout });
        }
        if bytes.len() + 1 != expected {
            return Err(length);
        }
        let (steps, bytes) = bytes.split_first_chunk().ok_or(length)?;
        let (episode_return, bytes) = bytes.split_first_chunk().ok_or(length)?;
        let (cells, members) = bytes.split_at(parameters.agents);
        Ok(Self {
            steps: u32::from_le_bytes(*steps),
            episode_return: f64::from_le_bytes(*episode_return),
            ring: Ring { cells, members },
        })
    }

    /// Refuses what no episode of the ring can be in.
    pub(super) fn check(self, parameters: &Parameters) -> Result<Self, StateError> {
        if self.steps > parameters.episode_limit {
            return Err(StateError::Steps(self.steps));
        }
        if !self.episode_return.is_finite() {
            return Err(StateError::Return);
        }
        let ring = self.ring;
        let off = ring.cells.iter().position(|cell| usize::from(*cell) >= parameters.cells);
        if let Some(agent) = off {
            return Err(StateError::Cell { agent, cell: ring.cells[agent] });
        }
        let all = all_agents(parameters.agents);
        if let Some(group) = ring.groups().position(|members| members & !all != 0) {
            return Err(StateError::Member { group });
        }
        let missing = all & !ring.groups().fold(0, |covered, members| covered | members);
        if missing != 0 {
            return Err(StateError::NoGroup { agent: missing.trailing_zeros() as usize });
        }
        Ok(self)
    }
}
