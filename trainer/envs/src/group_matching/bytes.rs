//! An episode as bytes: version, steps, return, then a byte per cell and a bit per member.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::parameters::Parameters;
use super::ring::{Ring, all_agents, member_bytes};
use crate::environment::StateError;

/// The version of the layout.
const LAYOUT: u8 = 1;
/// Bytes before the cells: the layout, the steps, the return.
const HEAD: usize = 1 + 4 + 8;

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

/// Who stands where in a saved state of such a ring, and who belongs together.
///
/// # Errors
/// The bytes are no state of it.
pub fn ring_of<'a>(parameters: &Parameters, state: &'a [u8]) -> Result<Ring<'a>, StateError> {
    Ok(State::read(parameters, state)?.check(parameters)?.ring)
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
        let wanted = state_bytes(parameters);
        let length = StateError::Length { found: bytes.len(), wanted };
        let Some((&found, rest)) = bytes.split_first() else { return Err(length) };
        if found != LAYOUT {
            return Err(StateError::Version { found, wanted: LAYOUT });
        }
        let (Some((steps, rest)), true) = (rest.split_first_chunk(), bytes.len() == wanted) else {
            return Err(length);
        };
        let Some((episode_return, bytes)) = rest.split_first_chunk() else { return Err(length) };
        let (cells, members) = bytes.split_at(parameters.agents);
        Ok(Self {
            steps: u32::from_le_bytes(*steps),
            episode_return: f64::from_le_bytes(*episode_return),
            ring: Ring { cells, members },
        })
    }

    /// Refuses what no episode of the ring can be in.
    pub(super) fn check(self, parameters: &Parameters) -> Result<Self, StateError> {
        self.flaw(parameters).map_or(Ok(self), |flaw| Err(StateError::Impossible(flaw)))
    }

    fn flaw(self, parameters: &Parameters) -> Option<String> {
        let Self { steps, episode_return, ring } = self;
        if steps > parameters.episode_limit {
            return Some(format!("it is {steps} steps long"));
        }
        if !episode_return.is_finite() {
            return Some("its return is no number".into());
        }
        let off = ring.cells.iter().position(|cell| usize::from(*cell) >= parameters.cells);
        if let Some(agent) = off {
            return Some(format!("agent {agent} is in cell {}", ring.cells[agent]));
        }
        let all = all_agents(parameters.agents);
        if let Some(group) = ring.groups().position(|members| members & !all != 0) {
            return Some(format!("group {group} has a member that is no agent"));
        }
        let missing = all & !ring.groups().fold(0, |covered, members| covered | members);
        (missing != 0).then(|| format!("agent {} has no group", missing.trailing_zeros()))
    }
}
