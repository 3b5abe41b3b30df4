//! How an episode starts.

use alloc::vec::Vec;

use rand_xoshiro::Xoshiro256PlusPlus;

use super::grid::{agent_candidates, sites};
use super::rules::{self, Constants};
use super::scenarios::{BuildingPlan, Scenario};
use super::state::{
    AgentKind, AgentState, BuildingKind, BuildingState, MAX_BUILDINGS, SIDE, Status,
};
use crate::random::{below, chance, unit};

/// Cells to draw from without replacement, kept so that a reset allocates nothing.
#[derive(Clone, Debug)]
pub(super) struct Lots {
    cells: Vec<(u8, u8)>,
}

impl Lots {
    pub(super) fn new() -> Self {
        Self { cells: Vec::with_capacity(usize::from(SIDE) * usize::from(SIDE)) }
    }

    fn refill(&mut self, cells: impl Iterator<Item = (u8, u8)>) {
        self.cells.clear();
        self.cells.extend(cells);
    }

    fn draw(&mut self, rng: &mut Xoshiro256PlusPlus) -> (u8, u8) {
        let index = below(rng, self.cells.len());
        self.cells.remove(index)
    }
}

/// Draws the kinds of a scenario's buildings.
fn building_kinds(
    plan: &BuildingPlan,
    rng: &mut Xoshiro256PlusPlus,
) -> [BuildingKind; MAX_BUILDINGS] {
    let mut kinds = [BuildingKind::Fast; MAX_BUILDINGS];
    match plan {
        BuildingPlan::Kinds(given) => kinds[..given.len()].copy_from_slice(given),
        BuildingPlan::Count(count) => {
            for kind in &mut kinds[..*count] {
                *kind = BuildingKind::ALL[below(rng, 2)];
            }
        }
    }
    kinds
}

/// Draws one building on one of the sites that are left; it does not burn yet.
fn draw_building(
    kind: BuildingKind,
    lots: &mut Lots,
    rng: &mut Xoshiro256PlusPlus,
) -> BuildingState {
    let (x, y) = lots.draw(rng);
    let (low, high) = if chance(rng, 0.5) { (0.25, 0.4) } else { (0.6, 0.75) };
    let share = unit(rng);
    let health = low * share + high * (1.0 - share);
    let (shortest, longest) = kind.periods();
    let period = shortest + below(rng, usize::from(longest - shortest) + 1) as u16;
    BuildingState {
        health,
        fire: 0.0,
        period,
        to_next_fire: period,
        since_last_fire: 0,
        kind,
        status: Status::Open,
        x,
        y,
    }
}

/// Draws agents and buildings of an episode into slices of the scenario's sizes.
///
/// The draws come in the order of the dissertation's code.
pub(super) fn draw_city(
    constants: &Constants,
    spacing: u8,
    scenario: &Scenario,
    lots: &mut Lots,
    rng: &mut Xoshiro256PlusPlus,
    agents: &mut [AgentState],
    buildings: &mut [BuildingState],
) {
    let kinds = building_kinds(&scenario.buildings, rng);
    lots.refill(agent_candidates(spacing, agents.len()));
    for (agent, &kind) in agents.iter_mut().zip(&scenario.team) {
        let (x, y) = lots.draw(rng);
        *agent = AgentState::at(kind, x, y);
    }
    lots.refill(sites(spacing));
    for (building, kind) in buildings.iter_mut().zip(kinds) {
        *building = draw_building(kind, lots, rng);
    }
    for building in buildings {
        if chance(rng, constants.init_fire_chance) {
            rules::ignite(building);
        }
    }
}

/// What fills the slots of absent agents.
pub(super) const ABSENT_AGENT: AgentState = AgentState::at(AgentKind::Firefighter, 0, 0);

/// What fills the slots of absent buildings.
pub(super) const ABSENT_BUILDING: BuildingState = BuildingState {
    health: 1.0,
    fire: 0.0,
    period: 1,
    to_next_fire: 1000,
    since_last_fire: 0,
    kind: BuildingKind::Fast,
    status: Status::Complete,
    x: 0,
    y: 0,
};
