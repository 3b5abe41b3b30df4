//! A hand-written allocation that looks at the whole team.

use super::rules::Constants;
use super::state::{AgentKind, AgentState, BuildingState, City, MAX_BUILDINGS};
use crate::decisions::UNASSIGNED;

/// Agents already given to one building, by kind.
#[derive(Clone, Copy, Default)]
struct Given([u8; 3]);

/// Gives agents, all firefighters first, then generalists, then builders, the building of lowest cost.
///
/// Ties go to the lower building index. Without an open building agents stay [`UNASSIGNED`], as do
/// entries beyond the team. The cost sees health as feature rows show it, rounded to f32, so that the
/// answer is the same from a state and from its rows.
pub fn coordinated_allocation(city: City<'_>, allocation: &mut [u8]) {
    const ORDER: [AgentKind; 3] =
        [AgentKind::Firefighter, AgentKind::Generalist, AgentKind::Builder];
    allocation.fill(UNASSIGNED);
    let mut given = [Given::default(); MAX_BUILDINGS];
    for kind in ORDER {
        for (agent, task) in city.agents.iter().zip(allocation.iter_mut()) {
            if agent.kind != kind {
                continue;
            }
            *task = cheapest_building(agent, city.buildings, &given);
            if let Some(given) = given.get_mut(usize::from(*task)) {
                given.0[kind as usize] += 1;
            }
        }
    }
}

fn cheapest_building(agent: &AgentState, buildings: &[BuildingState], given: &[Given]) -> u8 {
    let mut best = (f64::INFINITY, UNASSIGNED);
    for ((building, given), index) in buildings.iter().zip(given).zip(0..) {
        if building.is_open() {
            let cost = cost(agent, building) + crowding(agent.kind, given);
            if cost < best.0 {
                best = (cost, index);
            }
        }
    }
    best.1
}

/// What it takes this agent, and what waits for it, at a building that nobody else goes to.
fn cost(agent: &AgentState, building: &BuildingState) -> f64 {
    let travel = agent.travel_time_to(building);
    let health = f64::from(building.health as f32);
    let to_next_fire = f64::from(building.to_next_fire);
    if building.is_burning() {
        let burn_rate = Constants::default().fire_burn_rate * building.kind.burn_rate();
        let lifetime = health / burn_rate;
        match agent.kind {
            AgentKind::Firefighter => travel + 0.15 * (lifetime - travel).max(0.0),
            AgentKind::Generalist => {
                travel + 0.2 * lifetime + if travel > lifetime { 8.0 } else { 0.0 }
            }
            AgentKind::Builder => travel + 12.0,
        }
    } else {
        match agent.kind {
            AgentKind::Builder => {
                let too_late = if to_next_fire < travel { 20.0 } else { 0.0 };
                travel + 4.0 * (1.0 - health) + too_late
            }
            AgentKind::Firefighter => travel + 15.0 + 0.5 * to_next_fire,
            AgentKind::Generalist => travel + 10.0 + 0.5 * to_next_fire,
        }
    }
}

/// Agents of one kind are better spread; a generalist does less where a firefighter goes.
fn crowding(kind: AgentKind, given: &Given) -> f64 {
    let same = 8.0 * f64::from(given.0[kind as usize]);
    let firefighters = given.0[AgentKind::Firefighter as usize];
    let redundant = kind == AgentKind::Generalist && firefighters > 0;
    same + if redundant { 1.5 } else { 0.0 }
}
