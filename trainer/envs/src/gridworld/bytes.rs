//! An episode as bytes: version, steps, return, finished tiers, then cells, what was found, and the pits.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::rules::{Episode, Pit, Rules};
use crate::bytes::{LAYOUT, Reader};
use crate::environment::StateError;

/// Bytes before the cells: the layout, the steps, the return, the tiers.
const HEAD: usize = 1 + 4 + 8 + 1;
/// Bytes of a pit: its probability, its steps, whether it is open.
const PIT: usize = 8 + 4 + 1;

/// Bytes of a state under such rules.
pub fn state_bytes(rules: &Rules) -> usize {
    bytes_of(rules.agents(), rules.map.pits().len())
}

fn bytes_of(agents: usize, pits: usize) -> usize {
    HEAD + 3 * agents + PIT * pits
}

/// What the bytes of a state say.
#[derive(Clone, Copy, Debug)]
pub(super) struct State<'a> {
    steps: u32,
    episode_return: f64,
    pub(super) tiers: u8,
    cells: &'a [[u8; 2]],
    /// What each agent found.
    pub(super) found: &'a [u8],
    pits: &'a [[u8; PIT]],
}

impl<'a> State<'a> {
    /// Adds the bytes of an episode.
    pub(super) fn write(episode: &Episode, agents: usize, bytes: &mut Vec<u8>) {
        bytes.push(LAYOUT);
        bytes.extend_from_slice(&episode.steps.to_le_bytes());
        bytes.extend_from_slice(&episode.episode_return.to_le_bytes());
        bytes.push(episode.tiers);
        bytes.extend(episode.cells[..agents].iter().flat_map(|cell| cell.to_le_bytes()));
        bytes.extend_from_slice(&episode.found[..agents]);
        for pit in &episode.pits {
            bytes.extend_from_slice(&pit.probability.to_le_bytes());
            bytes.extend_from_slice(&pit.ticks.to_le_bytes());
            bytes.push(pit.is_open.into());
        }
    }

    /// Reads what [`write`](Self::write) wrote of so many agents and pits; nothing is checked but the length.
    pub(super) fn read(
        (agents, pits): (usize, usize),
        bytes: &'a [u8],
    ) -> Result<Self, StateError> {
        let mut reader = Reader::new(bytes, bytes_of(agents, pits))?;
        Ok(Self {
            steps: reader.u32(),
            episode_return: reader.f64(),
            tiers: reader.u8(),
            cells: reader.parts(agents),
            found: reader.slice(agents),
            pits: reader.parts(pits),
        })
    }

    /// The cell of an agent.
    #[inline]
    pub(super) fn cell(&self, agent: usize) -> u16 {
        u16::from_le_bytes(self.cells[agent])
    }

    /// A pit as it was when somebody last looked.
    #[inline]
    pub(super) fn pit(&self, pit: usize) -> Pit {
        let mut reader = Reader::part(&self.pits[pit]);
        Pit { probability: reader.f64(), ticks: reader.u32(), is_open: reader.u8() == 1 }
    }

    /// Goes on from here.
    pub(super) fn continue_in(self, episode: &mut Episode) {
        (episode.steps, episode.episode_return) = (self.steps, self.episode_return);
        episode.tiers = self.tiers;
        for (agent, found) in self.found.iter().enumerate() {
            (episode.cells[agent], episode.found[agent]) = (self.cell(agent), *found);
        }
        (0..self.pits.len()).for_each(|pit| episode.pits[pit] = self.pit(pit));
    }

    /// Refuses what no episode can be in.
    pub(super) fn check(self, rules: &Rules) -> Result<Self, StateError> {
        self.flaw(rules).map_or(Ok(self), |flaw| Err(StateError::Impossible(flaw)))
    }

    fn flaw(self, rules: &Rules) -> Option<String> {
        let Self { steps, episode_return, tiers, .. } = self;
        if steps > rules.episode_limit {
            return Some(format!("it is {steps} steps long"));
        }
        if !episode_return.is_finite() {
            return Some("its return is no number".into());
        }
        if usize::from(tiers) > rules.tiers.len() {
            return Some(format!("{tiers} tiers are finished"));
        }
        let known = (1_u16 << rules.map.treasures()) - 1;
        for agent in 0..rules.agents() {
            let cell = self.cell(agent);
            if usize::from(cell) >= super::CELLS || !rules.map.is_open(cell, tiers) {
                return Some(format!("agent {agent} is in cell {cell}"));
            }
            if u16::from(self.found[agent]) & !known != 0 {
                return Some(format!("agent {agent} found a treasure that there is not"));
            }
        }
        let is_sound = |pit: &Pit| (0.0..=1.0).contains(&pit.probability) && pit.ticks <= steps;
        let unsound = (0..self.pits.len()).find(|pit| !is_sound(&self.pit(*pit)));
        unsound.map(|pit| format!("pit {pit} opens with an impossible probability or too late"))
    }
}
