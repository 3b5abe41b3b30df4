//! Reads a city back from feature rows, so that allocation rules work on messages alone.

use alloc::vec::Vec;
use core::fmt;

use rand_xoshiro::Xoshiro256PlusPlus;

use super::allocation::AllocationRule;
use super::features::{
    AVAILABLE, BURNING, COMPLETE, FEATURES, FIRE, HEALTH, IGNITION_RATE, SINCE_LAST_FIRE, X_SCALED,
    Y_SCALED,
};
use super::relation::write_relation;
use super::reset::ABSENT_BUILDING;
use super::rules::ACTIONS;
use super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS,
    NO_BUILDING, Status, UNASSIGNED,
};

/// A row that no city can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeError {
    /// The rows are shorter than the counts say, or a row has fewer than 58 columns.
    BadLength,
    /// More than 64 agents or 25 buildings.
    TooLarge,
    /// A feature of this entity is not a finite number.
    NonFinite {
        /// The entity's row.
        entity: usize,
    },
    /// A one-hot of this entity's row is missing, or a value lies outside its range.
    BadRow {
        /// The entity's row.
        entity: usize,
    },
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BadLength => f.write_str("the feature rows are too short"),
            Self::TooLarge => f.write_str("more agents or buildings than a city can have"),
            Self::NonFinite { entity } => write!(f, "a feature of entity {entity} is not finite"),
            Self::BadRow { entity } => {
                write!(f, "the row of entity {entity} describes no agent or building")
            }
        }
    }
}

impl core::error::Error for DecodeError {}

/// The parts of a frame that describe a city.
#[derive(Clone, Copy, Debug)]
pub struct CityRows<'a> {
    /// Features `[N, stride]` with N = agents + tasks; the first 58 columns of a row count.
    pub rows: &'a [f32],
    /// Columns of a row.
    pub stride: usize,
    /// Agent rows A, present or not.
    pub agents: usize,
    /// Building rows T, present or not.
    pub tasks: usize,
    /// The entities that exist; bit e stands for row e.
    pub present: u128,
    /// The open buildings; bit b stands for row A + b.
    pub open_tasks: u32,
}

/// Decodes cities into buffers that it keeps.
#[derive(Clone, Debug)]
pub struct CityDecoder {
    agents: Vec<AgentState>,
    agent_rows: Vec<usize>,
    buildings: Vec<BuildingState>,
    team_allocation: Vec<u8>,
}

impl Default for CityDecoder {
    fn default() -> Self {
        Self::new()
    }
}

impl CityDecoder {
    /// A decoder with room for the largest city: decoding never allocates.
    pub fn new() -> Self {
        Self {
            agents: Vec::with_capacity(MAX_AGENTS),
            agent_rows: Vec::with_capacity(MAX_AGENTS),
            buildings: Vec::with_capacity(MAX_BUILDINGS),
            team_allocation: Vec::with_capacity(MAX_AGENTS),
        }
    }

    /// Reads the present agents, in the order of their rows, and all buildings, absent ones as closed.
    pub fn decode(&mut self, frame: &CityRows<'_>) -> Result<City<'_>, DecodeError> {
        if frame.agents > MAX_AGENTS || frame.tasks > MAX_BUILDINGS {
            return Err(DecodeError::TooLarge);
        }
        let entities = frame.agents + frame.tasks;
        if frame.stride < FEATURES || frame.rows.len() / frame.stride < entities {
            return Err(DecodeError::BadLength);
        }
        self.agents.clear();
        self.agent_rows.clear();
        self.buildings.clear();
        let rows = frame.rows.chunks_exact(frame.stride).map(|row| &row[..FEATURES]);
        for (entity, row) in rows.take(entities).enumerate() {
            let present = frame.present >> entity & 1 == 1;
            if present && !row.iter().all(|value| value.is_finite()) {
                return Err(DecodeError::NonFinite { entity });
            }
            let bad_row = DecodeError::BadRow { entity };
            if let Some(task) = entity.checked_sub(frame.agents) {
                let open = frame.open_tasks >> task & 1 == 1;
                let building = if present { building(row, open) } else { Some(ABSENT_BUILDING) };
                self.buildings.push(building.ok_or(bad_row)?);
            } else if present {
                self.agents.push(agent(row).ok_or(bad_row)?);
                self.agent_rows.push(entity);
            }
        }
        for agent in &mut self.agents {
            let present = |task: usize| frame.present >> (frame.agents + task) & 1 == 1;
            let beside = self
                .buildings
                .iter()
                .enumerate()
                .position(|(task, building)| present(task) && agent.distance_to(building) == 1);
            agent.beside = beside.map_or(NO_BUILDING, |index| index as u8);
        }
        Ok(City { agents: &self.agents, buildings: &self.buildings })
    }

    /// Writes the relation `[N, RELATIONS]` of every row of the frame that was decoded last to a
    /// building; see [`write_relation`].
    pub fn write_relation(&self, frame: &CityRows<'_>, task: usize, relation: &mut [f32]) {
        let city = City { agents: &self.agents, buildings: &self.buildings };
        write_relation(city, task, &self.agent_rows, frame.agents, relation);
    }

    /// Allocates from a frame alone: writes for every agent row `[A]` an open building or
    /// [`UNASSIGNED`], which absent agents get too.
    pub fn allocate(
        &mut self,
        rule: AllocationRule,
        frame: &CityRows<'_>,
        rng: &mut Xoshiro256PlusPlus,
        allocation: &mut [u8],
    ) -> Result<(), DecodeError> {
        if allocation.len() < frame.agents {
            return Err(DecodeError::BadLength);
        }
        self.decode(frame)?;
        self.team_allocation.resize(self.agents.len(), UNASSIGNED);
        let city = City { agents: &self.agents, buildings: &self.buildings };
        rule.allocate(city, rng, &mut self.team_allocation);
        allocation.fill(UNASSIGNED);
        for (&row, &task) in self.agent_rows.iter().zip(&self.team_allocation) {
            allocation[row] = task;
        }
        Ok(())
    }
}

fn agent(row: &[f32]) -> Option<AgentState> {
    let kind = AgentKind::ALL.into_iter().find(|kind| row[kind.type_index()] == 1.0)?;
    let (x, y) = place(row)?;
    let mut available = 0;
    for (action, &value) in row[AVAILABLE..][..ACTIONS].iter().enumerate() {
        available |= u16::from(value != 0.0) << action;
    }
    Some(AgentState { available, ..AgentState::at(kind, x, y) })
}

fn building(row: &[f32], open: bool) -> Option<BuildingState> {
    let kind = BuildingKind::ALL.into_iter().find(|kind| row[kind.type_index()] == 1.0)?;
    let (x, y) = place(row)?;
    let rate = f64::from(row[IGNITION_RATE]) * 0.0875 + 0.0125;
    let period = whole(1.0 / rate, 1.0, f64::from(u16::MAX))?;
    let since_last_fire = whole(f64::from(row[SINCE_LAST_FIRE]) * period, 0.0, period)?;
    let status = match (open, row[COMPLETE] != 0.0) {
        (true, _) => Status::Open,
        (false, true) => Status::Complete,
        (false, false) => Status::BurnedDown,
    };
    Some(BuildingState {
        health: row[HEALTH].into(),
        fire: if row[BURNING] == 0.0 { 0.0 } else { row[FIRE].into() },
        period: period as u16,
        to_next_fire: if open { (period - since_last_fire) as u16 } else { 1000 },
        since_last_fire: since_last_fire as u16,
        kind,
        status,
        x,
        y,
    })
}

fn place(row: &[f32]) -> Option<(u8, u8)> {
    let coordinate = |column: usize| whole(f64::from(row[column]) * 16.0, 0.0, 15.0);
    Some((coordinate(X_SCALED)? as u8, coordinate(Y_SCALED)? as u8))
}

/// The nearest whole number, where it lies in the range.
fn whole(value: f64, low: f64, high: f64) -> Option<f64> {
    let rounded = libm::round(value);
    (low..=high).contains(&rounded).then_some(rounded)
}
