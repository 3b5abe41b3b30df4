//! States of the environment that ALMA was made for.

use sortie_envs::save_the_city::{AgentState, BuildingState, City, with_city};

/// Agents and buildings of one state.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct CityState {
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
}

impl CityState {
    /// Takes over a state as the environment saves it.
    pub(super) fn read(&mut self, state: &[u8]) {
        with_city(state, |city| {
            self.agents.clear();
            self.agents.extend_from_slice(city.agents);
            self.buildings.clear();
            self.buildings.extend_from_slice(city.buildings);
        });
    }

    /// The agents and buildings.
    pub(super) fn city(&self) -> City<'_> {
        City { agents: &self.agents, buildings: &self.buildings }
    }
}
