//! The compact state of agents and buildings, from which everything else follows.

use serde::{Deserialize, Serialize};

/// Cells along one side of the square grid.
pub const SIDE: u8 = 16;
/// Most agents that a scenario set may have.
pub const MAX_AGENTS: usize = 64;
/// Most buildings: a spacing of at least 3 leaves no more sites.
pub const MAX_BUILDINGS: usize = 25;
/// Marks an agent that stands beside no building.
pub const NO_BUILDING: u8 = 0xFF;

/// What an agent is good at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum AgentKind {
    /// Fights fires.
    Firefighter,
    /// Repairs buildings.
    Builder,
    /// Moves fast, protects from damage, and helps the weaker kind of a pair.
    Generalist,
}

impl AgentKind {
    /// All kinds, in the order of their type index.
    pub const ALL: [Self; 3] = [Self::Firefighter, Self::Builder, Self::Generalist];

    /// Column of the type's one-hot in a feature row.
    pub const fn type_index(self) -> usize {
        2 + self as usize
    }

    /// The letter that stands for the kind in team lists.
    pub const fn letter(self) -> char {
        match self {
            Self::Firefighter => 'F',
            Self::Builder => 'B',
            Self::Generalist => 'G',
        }
    }

    /// The kind that a letter stands for.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.letter() == letter)
    }

    /// Speed at fighting fires.
    pub const fn fire_speed(self) -> f64 {
        match self {
            Self::Firefighter => 1.0,
            Self::Builder => 0.05,
            Self::Generalist => 0.0,
        }
    }

    /// Speed at building.
    pub const fn build_speed(self) -> f64 {
        match self {
            Self::Firefighter => 0.05,
            Self::Builder => 1.0,
            Self::Generalist => 0.0,
        }
    }

    /// Whether the agent can block the damage of a fire.
    pub const fn can_freeze(self) -> bool {
        matches!(self, Self::Generalist)
    }

    /// Cells that the longest move spans.
    pub const fn longest_move(self) -> u8 {
        match self {
            Self::Generalist => 2,
            _ => 1,
        }
    }
}

/// How a building burns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum BuildingKind {
    /// Burns down fast, ignites rarely.
    Fast,
    /// Burns down slowly, ignites often.
    Slow,
}

impl BuildingKind {
    /// Both kinds, in the order of their type index.
    pub const ALL: [Self; 2] = [Self::Fast, Self::Slow];

    /// Column of the type's one-hot in a feature row.
    pub const fn type_index(self) -> usize {
        self as usize
    }

    /// The letter that stands for the kind in recorded episodes.
    pub const fn letter(self) -> char {
        match self {
            Self::Fast => 'F',
            Self::Slow => 'S',
        }
    }

    /// The kind that a letter stands for.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.letter() == letter)
    }

    /// Share of the fire burn rate that applies.
    pub const fn burn_rate(self) -> f64 {
        match self {
            Self::Fast => 1.0,
            Self::Slow => 0.5,
        }
    }

    /// Smallest and largest ignition period in steps, both included.
    pub const fn periods(self) -> (u16, u16) {
        match self {
            Self::Fast => (60, 80),
            Self::Slow => (10, 30),
        }
    }
}

/// Whether a building still needs work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Status {
    /// Neither complete nor burned down.
    Open,
    /// Health is exactly 1.
    Complete,
    /// Health is exactly 0.
    BurnedDown,
}

impl Status {
    /// The status that a health means.
    pub fn of_health(health: f64) -> Self {
        if health == 1.0 {
            Self::Complete
        } else if health == 0.0 {
            Self::BurnedDown
        } else {
            Self::Open
        }
    }
}

/// One agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AgentState {
    /// What it is good at.
    pub kind: AgentKind,
    /// Column, `0..16`, growing to the east.
    pub x: u8,
    /// Row, `0..16`, growing to the north.
    pub y: u8,
    /// The building orthogonally beside it, or [`NO_BUILDING`].
    pub beside: u8,
    /// Bit u set where action u is available.
    pub available: u16,
}

impl AgentState {
    /// An agent on a cell; the simulator fills in what is beside it and what it may do.
    pub const fn at(kind: AgentKind, x: u8, y: u8) -> Self {
        Self { kind, x, y, beside: NO_BUILDING, available: 1 }
    }

    /// Steps of length 1 from the agent's cell to the building's.
    pub const fn distance_to(&self, building: &BuildingState) -> u8 {
        manhattan((self.x, self.y), (building.x, building.y))
    }

    /// Steps until the agent stands beside the building, if nothing is in its way; halves count
    /// for kinds that move by two.
    pub fn travel_time_to(&self, building: &BuildingState) -> f64 {
        let cells = self.distance_to(building).saturating_sub(1);
        f64::from(cells) / f64::from(self.kind.longest_move())
    }
}

/// One building.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BuildingState {
    /// 1 = complete, 0 = burned down.
    pub health: f64,
    /// Strength of the fire, 0 = none, 1 = full.
    pub fire: f64,
    /// Steps from one ignition to the next, constant in an episode.
    pub period: u16,
    /// Steps to the next ignition; 1000 once closed. Not shown to agents.
    pub to_next_fire: u16,
    /// Steps since the last ignition, or since the reset; 0 once closed.
    pub since_last_fire: u16,
    /// How it burns.
    pub kind: BuildingKind,
    /// Whether it still needs work.
    pub status: Status,
    /// Column, `0..16`, growing to the east.
    pub x: u8,
    /// Row, `0..16`, growing to the north.
    pub y: u8,
}

impl BuildingState {
    /// Whether it still needs work.
    pub fn is_open(&self) -> bool {
        self.status == Status::Open
    }

    /// Whether there is a fire, however weak.
    pub fn is_burning(&self) -> bool {
        self.fire > 0.0
    }
}

/// A city as agents and allocators see it: the existing agents and buildings.
#[derive(Clone, Copy, Debug)]
pub struct City<'a> {
    /// The agents, in index order.
    pub agents: &'a [AgentState],
    /// The buildings, in index order.
    pub buildings: &'a [BuildingState],
}

impl City<'_> {
    /// The open buildings as bits.
    pub fn open_tasks(&self) -> u32 {
        let mut open = 0;
        for (task, building) in self.buildings.iter().enumerate() {
            open |= u32::from(building.is_open()) << task;
        }
        open
    }
}

/// Steps of length 1 between two cells.
pub const fn manhattan(from: (u8, u8), to: (u8, u8)) -> u8 {
    from.0.abs_diff(to.0) + from.1.abs_diff(to.1)
}
