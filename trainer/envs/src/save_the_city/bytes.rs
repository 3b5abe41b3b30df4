//! The state of an episode as bytes: counts, then agents, then buildings, little-endian.

use alloc::format;
use alloc::vec::Vec;

use super::episode::{EpisodeMetrics, KindCount};
use super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS, Status,
};
use crate::bytes::LAYOUT;
use crate::environment::StateError;

const HEADER: usize = 60;
const AGENT: usize = 6;
const BUILDING: usize = 25;

/// Bytes of a state with so many agents and buildings.
pub(super) const fn state_bytes(agents: usize, buildings: usize) -> usize {
    HEADER + agents * AGENT + buildings * BUILDING
}

/// Appends a state.
pub(super) fn write_state(
    city: City<'_>,
    scenario: usize,
    metrics: &EpisodeMetrics,
    bytes: &mut Vec<u8>,
) {
    bytes.extend([LAYOUT, 0, city.agents.len() as u8, city.buildings.len() as u8]);
    bytes.extend((scenario as u32).to_le_bytes());
    let counts = [
        metrics.steps,
        metrics.fires_extinguished,
        metrics.buildings_completed,
        metrics.buildings_burned,
        metrics.firefights.pairs,
        metrics.firefights.kinds,
        metrics.builds.pairs,
        metrics.builds.kinds,
        0,
    ];
    counts.iter().for_each(|count| bytes.extend(count.to_le_bytes()));
    bytes.extend(metrics.episode_return.to_le_bytes());
    bytes.extend(metrics.health_delta.to_le_bytes());
    for agent in city.agents {
        let [low, high] = agent.available.to_le_bytes();
        bytes.extend([agent.kind as u8, agent.x, agent.y, agent.beside, low, high]);
    }
    for building in city.buildings {
        bytes.extend(building.health.to_le_bytes());
        bytes.extend(building.fire.to_le_bytes());
        for clock in [building.period, building.to_next_fire, building.since_last_fire] {
            bytes.extend(clock.to_le_bytes());
        }
        bytes.extend([building.kind as u8 | (building.status as u8) << 1, building.x, building.y]);
    }
}

/// A state's bytes, read where they are.
#[derive(Clone, Copy)]
pub(super) struct CityBytes<'a> {
    header: &'a [u8; HEADER],
    agents: &'a [[u8; AGENT]],
    buildings: &'a [[u8; BUILDING]],
}

impl<'a> CityBytes<'a> {
    /// Checks layout and length.
    #[inline]
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, StateError> {
        let length = |wanted| StateError::Length { found: bytes.len(), wanted };
        let (header, rest) = bytes.split_first_chunk::<HEADER>().ok_or_else(|| length(HEADER))?;
        if header[0] != LAYOUT {
            return Err(StateError::Version { found: header[0], wanted: LAYOUT });
        }
        let (agents, buildings) = (usize::from(header[2]), usize::from(header[3]));
        let wanted = state_bytes(agents, buildings);
        if bytes.len() != wanted {
            return Err(length(wanted));
        }
        if agents > MAX_AGENTS || buildings > MAX_BUILDINGS {
            let reason = format!("{agents} agents and {buildings} buildings");
            return Err(StateError::Impossible(reason));
        }
        let (agents, buildings) = rest.split_at(agents * AGENT);
        Ok(Self { header, agents: agents.as_chunks().0, buildings: buildings.as_chunks().0 })
    }

    #[inline]
    pub(super) fn agents(&self) -> usize {
        self.agents.len()
    }

    pub(super) fn buildings(&self) -> usize {
        self.buildings.len()
    }

    /// The place of the episode's scenario in its list.
    pub(super) fn scenario(&self) -> usize {
        u32_at(self.header, 4) as usize
    }

    /// What was counted; whether it was solved or timed out follows from the rest.
    pub(super) fn metrics(&self) -> EpisodeMetrics {
        let count = |index: usize| u32_at(self.header, 8 + 4 * index);
        EpisodeMetrics {
            steps: count(0),
            buildings: self.buildings.len() as u32,
            fires_extinguished: count(1),
            buildings_completed: count(2),
            buildings_burned: count(3),
            firefights: KindCount { pairs: count(4), kinds: count(5) },
            builds: KindCount { pairs: count(6), kinds: count(7) },
            episode_return: f64_at(self.header, 44),
            health_delta: f64_at(self.header, 52),
            solved: false,
            timed_out: false,
        }
    }

    /// The available actions of an agent.
    #[inline]
    pub(super) fn available(&self, index: usize) -> u16 {
        let [.., low, high] = self.agents[index];
        u16::from_le_bytes([low, high])
    }

    #[inline]
    pub(super) fn agent(&self, index: usize) -> AgentState {
        let [kind, x, y, beside, low, high] = self.agents[index];
        let available = u16::from_le_bytes([low, high]);
        AgentState { kind: agent_kind(kind), x, y, beside, available }
    }

    #[inline]
    pub(super) fn building(&self, index: usize) -> BuildingState {
        let bytes = &self.buildings[index];
        let clock = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        BuildingState {
            health: f64_at(bytes, 0),
            fire: f64_at(bytes, 8),
            period: clock(16),
            to_next_fire: clock(18),
            since_last_fire: clock(20),
            kind: BuildingKind::ALL[usize::from(bytes[22] & 1)],
            status: status(bytes[22] >> 1),
            x: bytes[23],
            y: bytes[24],
        }
    }

    /// Whether a building still needs work.
    #[inline]
    pub(super) fn is_open(&self, building: usize) -> bool {
        status(self.buildings[building][22] >> 1) == Status::Open
    }

    /// The open buildings as bits.
    #[inline]
    pub(super) fn open_tasks(&self) -> u32 {
        (0..self.buildings.len()).map(|task| u32::from(self.is_open(task)) << task).sum()
    }
}

fn agent_kind(code: u8) -> AgentKind {
    match code {
        0 => AgentKind::Firefighter,
        1 => AgentKind::Builder,
        _ => AgentKind::Generalist,
    }
}

fn status(code: u8) -> Status {
    match code {
        0 => Status::Open,
        1 => Status::Complete,
        _ => Status::BurnedDown,
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

#[inline]
fn f64_at(bytes: &[u8], at: usize) -> f64 {
    let mut value = [0; 8];
    value.copy_from_slice(&bytes[at..at + 8]);
    f64::from_le_bytes(value)
}
