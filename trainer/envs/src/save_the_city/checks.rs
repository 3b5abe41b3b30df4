//! Which states the rules allow.

use alloc::format;

use super::error::CityError;
use super::scenarios::ScenarioSet;
use super::state::{AgentState, BuildingState, SIDE, Status};

/// Refuses a state that no episode of the set can be in.
pub(super) fn check_state(
    set: &ScenarioSet,
    agents: &[AgentState],
    buildings: &[BuildingState],
) -> Result<(), CityError> {
    let require = |holds: bool, what: &str, index: usize, reason: &str| {
        if holds { Ok(()) } else { Err(CityError::State(format!("{what} {index} {reason}"))) }
    };
    let on_map = |x: u8, y: u8| x < SIDE && y < SIDE;
    let fits = (1..=set.max_agents).contains(&agents.len());
    require(fits, "a team of", agents.len(), "does not fit the set")?;
    let fits = (1..=set.max_buildings).contains(&buildings.len());
    require(fits, "a number of buildings of", buildings.len(), "does not fit the set")?;
    for (index, building) in buildings.iter().enumerate() {
        let (health, fire) = (building.health, building.fire);
        let say = |holds, reason| require(holds, "building", index, reason);
        say(on_map(building.x, building.y), "is off the map")?;
        say((0.0..=1.0).contains(&health), "has a health outside 0..=1")?;
        say((0.0..=1.0).contains(&fire), "has a fire outside 0..=1")?;
        say(building.period > 0, "has a period of 0")?;
        let closed = Status::of_health(health) != Status::Open;
        say(!(closed && building.is_burning()), "is closed and burns")?;
        say(closed || building.to_next_fire > 0, "is open and its clock has run out")?;
    }
    for (index, agent) in agents.iter().enumerate() {
        let say = |holds, reason| require(holds, "agent", index, reason);
        say(on_map(agent.x, agent.y), "is off the map")?;
        let place = (agent.x, agent.y);
        let shared = agents[..index].iter().any(|other| (other.x, other.y) == place)
            || buildings.iter().any(|building| (building.x, building.y) == place);
        say(!shared, "shares its cell")?;
    }
    Ok(())
}
