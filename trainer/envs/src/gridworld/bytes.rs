//! An episode as bytes: version, steps, return, finished tiers, then cells, what was found, and the pits.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::episode::{Episode, Rules};
use super::pits::Pit;
use crate::environment::StateError;

/// The version of the layout.
const LAYOUT: u8 = 1;
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
    tiers: u8,
    cells: &'a [u8],
    found: &'a [u8],
    pits: &'a [[u8; PIT]],
}

impl<'a> State<'a> {
    /// Adds the bytes of an episode.
    pub(super) fn write(episode: &Episode, agents: usize, bytes: &mut Vec<u8>) {
        bytes.push(LAYOUT);
        bytes.extend_from_slice(&episode.steps.to_le_bytes());
        bytes.extend_from_slice(&episode.episode_return.to_le_bytes());
        bytes.push(episode.tiers);
        episode.cells[..agents]
            .iter()
            .for_each(|cell| bytes.extend_from_slice(&cell.to_le_bytes()));
        bytes.extend_from_slice(&episode.found[..agents]);
        for pit in &episode.pits {
            let mut own = [0; PIT];
            own[..8].copy_from_slice(&pit.probability.to_le_bytes());
            own[8..12].copy_from_slice(&pit.ticks.to_le_bytes());
            own[12] = pit.is_open.into();
            bytes.extend_from_slice(&own);
        }
    }

    /// Reads what [`write`](Self::write) wrote of so many agents and pits; nothing is checked but the length.
    pub(super) fn read(
        (agents, pits): (usize, usize),
        bytes: &'a [u8],
    ) -> Result<Self, StateError> {
        let wanted = bytes_of(agents, pits);
        match bytes.first() {
            Some(&found) if found != LAYOUT => {
                return Err(StateError::Version { found, wanted: LAYOUT });
            }
            Some(_) if bytes.len() == wanted => {}
            _ => return Err(StateError::Length { found: bytes.len(), wanted }),
        }
        let (head, rest) = bytes.split_at(HEAD);
        let (cells, rest) = rest.split_at(2 * agents);
        let (found, pits) = rest.split_at(agents);
        Ok(Self {
            steps: u32::from_le_bytes([head[1], head[2], head[3], head[4]]),
            episode_return: number(&head[5..13]),
            tiers: head[13],
            cells,
            found,
            pits: pits.as_chunks().0,
        })
    }

    /// The cell of an agent.
    #[inline]
    pub(super) fn cell(&self, agent: usize) -> u16 {
        u16::from_le_bytes([self.cells[2 * agent], self.cells[2 * agent + 1]])
    }

    /// What an agent found.
    #[inline]
    pub(super) fn found(&self, agent: usize) -> u8 {
        self.found[agent]
    }

    /// What all agents found.
    pub(super) fn all_found(&self) -> &[u8] {
        self.found
    }

    pub(super) fn tiers(&self) -> u8 {
        self.tiers
    }

    /// The probability that a pit opens next, as it was when somebody last looked.
    #[inline]
    pub(super) fn probability(&self, pit: u8) -> f64 {
        number(&self.pits[usize::from(pit)][..8])
    }

    /// A pit as it was when somebody last looked.
    pub(super) fn pit(&self, pit: usize) -> Pit {
        let bytes = &self.pits[pit];
        let ticks = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
        Pit { probability: number(&bytes[..8]), ticks, is_open: bytes[12] == 1 }
    }

    /// Goes on from here.
    pub(super) fn continue_in(self, episode: &mut Episode) {
        (episode.steps, episode.episode_return) = (self.steps, self.episode_return);
        episode.tiers = self.tiers;
        for agent in 0..self.found.len() {
            (episode.cells[agent], episode.found[agent]) = (self.cell(agent), self.found(agent));
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
            if u16::from(self.found(agent)) & !known != 0 {
                return Some(format!("agent {agent} found a treasure that there is not"));
            }
        }
        let is_sound = |pit: &Pit| (0.0..=1.0).contains(&pit.probability) && pit.ticks <= steps;
        let unsound = (0..self.pits.len()).find(|pit| !is_sound(&self.pit(*pit)));
        unsound.map(|pit| format!("pit {pit} opens with an impossible probability or too late"))
    }
}

fn number(bytes: &[u8]) -> f64 {
    bytes.first_chunk().map_or(f64::NAN, |bytes| f64::from_le_bytes(*bytes))
}
