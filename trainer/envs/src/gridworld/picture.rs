//! What there is to draw of a state, whatever the task.

use alloc::vec::Vec;

use super::bytes::State;
use super::map::{DOORS, FIRST_DOOR, MAX_TREASURES, PIT, WALL};
use super::pits::Pit;
use crate::environment::StateError;
use crate::spec::Spec;

/// What is in a cell of a map, beside agents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Nothing, or the start of an agent.
    Free,
    /// A wall.
    Wall,
    /// A pit.
    Pit,
    /// A door that opens once so many tiers are finished.
    Door(u8),
    /// A treasure of this kind.
    Treasure(u8),
}

impl Cell {
    /// All cells of a map as [`Spec::map`] has it, row by row.
    pub fn all(spec: &Spec) -> impl Iterator<Item = Self> + '_ {
        spec.map.iter().flat_map(|row| row.bytes()).map(Self::of)
    }

    fn of(character: u8) -> Self {
        const LAST_TREASURE: u8 = b'A' + MAX_TREASURES as u8 - 1;
        const LAST_DOOR: u8 = FIRST_DOOR + DOORS - 1;
        match character {
            WALL => Self::Wall,
            PIT => Self::Pit,
            b'A'..=LAST_TREASURE => Self::Treasure(character - b'A'),
            FIRST_DOOR..=LAST_DOOR => Self::Door(character - FIRST_DOOR + 1),
            _ => Self::Free,
        }
    }
}

/// A state as it is drawn, on the map of its spec.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// `[agents]`: where they are.
    pub cells: Vec<u16>,
    /// `[agents]`: what they found, kinds of treasures as bits.
    pub found: Vec<u8>,
    /// Tiers that are finished.
    pub tiers: u8,
    /// The pits in the order of their cells, each as it was when somebody last looked.
    pub pits: Vec<Pit>,
}

/// What there is to draw of a state.
///
/// # Errors
/// The bytes are no state of this gridworld.
pub fn picture_of(spec: &Spec, state: &[u8]) -> Result<Picture, StateError> {
    let agents = spec.shape.agents;
    let pits = Cell::all(spec).filter(|cell| *cell == Cell::Pit).count();
    let state = State::read((agents, pits), state)?;
    Ok(Picture {
        cells: (0..agents).map(|agent| state.cell(agent)).collect(),
        found: state.all_found().to_vec(),
        tiers: state.tiers(),
        pits: (0..pits).map(|pit| state.pit(pit)).collect(),
    })
}
