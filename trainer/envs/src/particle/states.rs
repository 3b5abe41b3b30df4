//! Episodes as bytes: version, steps and return, then what a scenario has.

use alloc::format;
use alloc::vec::Vec;

use super::bytes::{Reader, write_number};
use super::scenario::Scenario;
use crate::environment::StateError;

/// The version of the layout.
const LAYOUT: u8 = 1;
/// Bytes before the world: the layout, the steps, the return.
const HEAD: usize = 1 + 4 + 8;

/// What the bytes of a state say.
pub(super) struct State<W> {
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) world: W,
}

/// Bytes of every state of a scenario.
pub(super) fn state_bytes<S: Scenario>(scenario: &S) -> usize {
    let mut bytes = Vec::new();
    scenario.write(&scenario.world(), &mut bytes);
    HEAD + bytes.len()
}

/// Adds the bytes of a state.
pub(super) fn write<S: Scenario>(
    scenario: &S,
    (steps, episode_return, world): (u32, f64, &S::World),
    bytes: &mut Vec<u8>,
) {
    bytes.push(LAYOUT);
    bytes.extend_from_slice(&steps.to_le_bytes());
    write_number(episode_return, bytes);
    scenario.write(world, bytes);
}

/// Reads what [`write`] wrote, which has so many bytes.
pub(super) fn read<S: Scenario>(
    scenario: &S,
    wanted: usize,
    bytes: &[u8],
) -> Result<State<S::World>, StateError> {
    match bytes.first() {
        Some(&found) if found != LAYOUT => {
            return Err(StateError::Version { found, wanted: LAYOUT });
        }
        Some(_) if bytes.len() == wanted => {}
        _ => return Err(StateError::Length { found: bytes.len(), wanted }),
    }
    let mut reader = Reader::new(&bytes[1..]);
    let steps = reader.count();
    reader.refuse(steps > scenario.episode_limit(), || format!("it is {steps} steps long"));
    let state = State { steps, episode_return: reader.number(), world: scenario.read(&mut reader) };
    reader.flaw().map_or(Ok(state), |flaw| Err(StateError::Impossible(flaw)))
}
