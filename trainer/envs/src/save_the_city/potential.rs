//! A potential that shapes rewards: the farther agents are from their building, the lower.
//!
//! Shaping with `discount^m * phi(s') - phi(s)` leaves the best policy as it is (Ng, Harada and Russell
//! 1999). It is no part of the dissertation.

use super::state::{AgentState, BuildingState, City};

/// Potential of a state for a team at a task; without one an agent counts by its nearest open building.
///
/// `cell` is the potential of one cell between an agent and its building.
pub fn potential(
    cell: f32,
    city: City<'_>,
    team: impl Iterator<Item = usize>,
    task: Option<usize>,
) -> f32 {
    let at = |agent: &AgentState, building: &BuildingState| {
        -cell * f32::from(agent.distance_to(building).saturating_sub(1))
    };
    let nearest = |agent: &AgentState| {
        let open = city.buildings.iter().filter(|building| building.is_open());
        open.map(|building| at(agent, building)).reduce(f32::max).unwrap_or(0.0)
    };
    team.map(|agent| &city.agents[agent])
        .map(|agent| task.map_or_else(|| nearest(agent), |task| at(agent, &city.buildings[task])))
        .sum()
}
