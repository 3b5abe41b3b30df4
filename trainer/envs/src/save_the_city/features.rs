//! The feature row of one entity, written from its compact state.
//!
//! Every value is computed in f64 and rounded once to f32, so that rows rebuilt from stored states
//! equal the observed ones bit for bit.

use super::rules::ACTIONS;
use super::state::{AgentState, BuildingState, Status};

/// Columns of a feature row.
pub const FEATURES: usize = 58;

/// Most columns of a row that differ from zero: five of place and every action.
pub(super) const ROW_ENTRIES: usize = 5 + ACTIONS;

const X: usize = 5;
const Y: usize = 21;
pub(super) const X_SCALED: usize = 37;
pub(super) const Y_SCALED: usize = 38;
pub(super) const AVAILABLE: usize = 39;
pub(super) const HEALTH: usize = 51;
pub(super) const COMPLETE: usize = 52;
const BURNED_DOWN: usize = 53;
pub(super) const FIRE: usize = 54;
pub(super) const BURNING: usize = 55;
pub(super) const SINCE_LAST_FIRE: usize = 56;
pub(super) const IGNITION_RATE: usize = 57;

/// The availability mask of all actions.
const ALL_ACTIONS: u16 = (1 << ACTIONS) - 1;

/// Names of the columns.
#[rustfmt::skip]
pub const FEATURE_NAMES: [&str; FEATURES] = [
    "building-fast", "building-slow", "agent-firefighter", "agent-builder", "agent-generalist",
    "x-0", "x-1", "x-2", "x-3", "x-4", "x-5", "x-6", "x-7",
    "x-8", "x-9", "x-10", "x-11", "x-12", "x-13", "x-14", "x-15",
    "y-0", "y-1", "y-2", "y-3", "y-4", "y-5", "y-6", "y-7",
    "y-8", "y-9", "y-10", "y-11", "y-12", "y-13", "y-14", "y-15",
    "x-scaled", "y-scaled",
    "can-stay", "can-north", "can-east", "can-south", "can-west", "can-north-2",
    "can-east-2", "can-south-2", "can-west-2", "can-fight", "can-build", "can-freeze",
    "health", "complete", "burned-down", "fire", "burning", "since-last-fire", "ignition-rate",
];

/// Gives every column of an agent that may differ from zero, in rising order.
#[inline]
pub fn agent_features(agent: &AgentState, mut emit: impl FnMut(usize, f32)) {
    place(agent.kind.type_index(), agent.x, agent.y, &mut emit);
    // From bit to bit: most actions are not available, and testing each would be guessed wrong often.
    let mut available = agent.available & ALL_ACTIONS;
    while available != 0 {
        emit(AVAILABLE + available.trailing_zeros() as usize, 1.0);
        available &= available - 1;
    }
}

/// Gives every column of a building that may differ from zero, in rising order.
#[inline]
pub fn building_features(building: &BuildingState, mut emit: impl FnMut(usize, f32)) {
    place(building.kind.type_index(), building.x, building.y, &mut emit);
    emit(HEALTH, building.health as f32);
    match building.status {
        Status::Open => {}
        Status::Complete => emit(COMPLETE, 1.0),
        Status::BurnedDown => emit(BURNED_DOWN, 1.0),
    }
    if building.is_burning() {
        emit(FIRE, building.fire as f32);
        emit(BURNING, 1.0);
    }
    let since = f64::from(building.since_last_fire) / f64::from(building.period);
    emit(SINCE_LAST_FIRE, since as f32);
    let known = IGNITION_RATES.get(usize::from(building.period)).copied();
    emit(IGNITION_RATE, known.unwrap_or_else(|| ignition_rate(building.period)));
}

/// 1 for the shortest period of all, 10 steps, and 0 for the longest, 80.
const fn ignition_rate(period: u16) -> f32 {
    ((1.0 / period as f64 - 1.0 / 80.0) / (1.0 / 10.0 - 1.0 / 80.0)) as f32
}

/// The rates of all usual periods, since divisions would take a good part of an observation.
const IGNITION_RATES: [f32; 81] = {
    let mut rates = [0.0; 81];
    let mut period = 1;
    while period < rates.len() {
        rates[period] = ignition_rate(period as u16);
        period += 1;
    }
    rates
};

#[inline]
fn place(type_index: usize, x: u8, y: u8, emit: &mut impl FnMut(usize, f32)) {
    emit(type_index, 1.0);
    emit(X + usize::from(x), 1.0);
    emit(Y + usize::from(y), 1.0);
    emit(X_SCALED, (f64::from(x) / 16.0) as f32);
    emit(Y_SCALED, (f64::from(y) / 16.0) as f32);
}

/// Writes an agent's dense row into the first [`FEATURES`] columns of `row`.
pub fn write_agent_row(agent: &AgentState, row: &mut [f32]) {
    let row = known_length(row);
    row.fill(0.0);
    agent_features(agent, |column, value| row[column] = value);
}

/// Writes a building's dense row into the first [`FEATURES`] columns of `row`.
pub fn write_building_row(building: &BuildingState, row: &mut [f32]) {
    let row = known_length(row);
    row.fill(0.0);
    building_features(building, |column, value| row[column] = value);
}

/// The columns of a row as an array, so that writing them needs few checks.
#[inline]
fn known_length(row: &mut [f32]) -> &mut [f32; FEATURES] {
    row.first_chunk_mut().expect("a row has all columns of the shape")
}
