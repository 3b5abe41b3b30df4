//! The dissertation's hand-written allocation: every agent for itself.

use super::state::{AgentKind, AgentState, BuildingState, City};
use crate::decisions::UNASSIGNED;

/// Gives every agent the nearest open building of the sort that it prefers.
///
/// Builders prefer buildings that do not burn, the others those that do; ties go to the lower index.
/// Without an open building agents stay [`UNASSIGNED`], as do entries beyond the team.
pub fn heuristic_allocation(city: City<'_>, allocation: &mut [u8]) {
    allocation.fill(UNASSIGNED);
    for (task, agent) in allocation.iter_mut().zip(city.agents) {
        *task = preferred_building(agent, city.buildings);
    }
}

fn preferred_building(agent: &AgentState, buildings: &[BuildingState]) -> u8 {
    let wants_fire = agent.kind != AgentKind::Builder;
    let open = buildings.iter().zip(0..).filter(|(building, _)| building.is_open());
    open.min_by_key(|(building, index)| {
        (building.is_burning() != wants_fire, agent.distance_to(building), *index)
    })
    .map_or(UNASSIGNED, |(_, index)| index)
}
