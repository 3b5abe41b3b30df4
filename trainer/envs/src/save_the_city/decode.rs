//! Reads a city back from feature rows, so that allocation rules work on messages alone.

use alloc::vec::Vec;

use super::observation::{
    AVAILABLE, BURNING, COMPLETE, FEATURES, FIRE, HEALTH, IGNITION_RATE, RELATIONS,
    SINCE_LAST_FIRE, X_SCALED, Y_SCALED, write_relation,
};
use super::rules::ACTIONS;
use super::scenarios::ABSENT_BUILDING;
use super::scripted::AllocationRule;
use super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS,
    NO_BUILDING, Status,
};
use crate::decisions::UNASSIGNED;
use crate::frame::{Frame, FrameError, FrameReader};
use crate::random::Random;

/// Decodes cities into buffers that it keeps.
#[derive(Clone, Debug)]
pub struct CityDecoder {
    agents: Vec<AgentState>,
    agent_rows: Vec<usize>,
    buildings: Vec<BuildingState>,
    /// The agent rows of the frame, with absent ones.
    slots: usize,
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
            slots: 0,
            team_allocation: Vec::with_capacity(MAX_AGENTS),
        }
    }

    /// Reads the present agents, in the order of their rows, and all buildings, absent ones as closed.
    pub fn decode(&mut self, frame: &Frame<'_>) -> Result<City<'_>, FrameError> {
        if frame.agents > MAX_AGENTS || frame.tasks > MAX_BUILDINGS {
            return Err(FrameError::TooLarge);
        }
        let entities = frame.agents + frame.tasks;
        if frame.stride < FEATURES || frame.rows.len() / frame.stride < entities {
            return Err(FrameError::BadLength);
        }
        self.agents.clear();
        self.agent_rows.clear();
        self.buildings.clear();
        self.slots = frame.agents;
        let rows = frame.rows.chunks_exact(frame.stride).map(|row| &row[..FEATURES]);
        for (entity, row) in rows.take(entities).enumerate() {
            let present = frame.present >> entity & 1 == 1;
            if present && !row.iter().all(|value| value.is_finite()) {
                return Err(FrameError::NonFinite { entity });
            }
            let bad_row = FrameError::BadRow { entity };
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
        Ok(self.city())
    }

    fn city(&self) -> City<'_> {
        City { agents: &self.agents, buildings: &self.buildings }
    }
}

impl FrameReader for CityDecoder {
    fn read(&mut self, frame: &Frame<'_>) -> Result<(), FrameError> {
        self.decode(frame).map(drop)
    }

    fn allocate(
        &mut self,
        rule: usize,
        random: &mut Random,
        allocation: &mut [u8],
    ) -> Result<(), FrameError> {
        if allocation.len() < self.slots {
            return Err(FrameError::BadLength);
        }
        self.team_allocation.resize(self.agents.len(), UNASSIGNED);
        let city = City { agents: &self.agents, buildings: &self.buildings };
        AllocationRule::ALL[rule].allocate(city, random, &mut self.team_allocation);
        allocation.fill(UNASSIGNED);
        for (&row, &task) in self.agent_rows.iter().zip(&self.team_allocation) {
            allocation[row] = task;
        }
        Ok(())
    }

    fn relations(&self) -> usize {
        RELATIONS
    }

    fn relate(&self, task: usize, relation: &mut [f32]) {
        write_relation(self.city(), task, &self.agent_rows, self.slots, relation);
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
