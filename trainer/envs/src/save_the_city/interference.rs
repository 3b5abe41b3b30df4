//! What somebody outside changes in a city between two steps.

use super::error::CityError;
use super::rules;
use super::simulator::SaveTheCity;
use super::state::{AgentState, BuildingState, City};

impl SaveTheCity {
    /// Puts an agent on another cell, between two steps.
    ///
    /// # Errors
    /// There is no such agent, or the cell is taken or none of the map; nothing has changed then.
    pub fn place_agent(
        &mut self,
        instance: usize,
        agent: usize,
        (x, y): (u8, u8),
    ) -> Result<(), CityError> {
        self.change(instance, |agents, _| {
            let own = agents.get_mut(agent).ok_or("there is no such agent")?;
            *own = AgentState { x, y, ..*own };
            Ok(())
        })
    }

    /// Sets a building on full fire and restarts its clock, between two steps.
    ///
    /// # Errors
    /// There is no such building, or it is complete or burned down; nothing has changed then.
    pub fn set_fire(&mut self, instance: usize, building: usize) -> Result<(), CityError> {
        self.change(instance, |_, buildings| {
            let own = buildings.get_mut(building).ok_or("there is no such building")?;
            if !own.is_open() {
                return Err("the building is complete or burned down");
            }
            rules::ignite(own);
            Ok(())
        })
    }

    /// Continues from a changed state.
    fn change(
        &mut self,
        instance: usize,
        change: impl FnOnce(&mut [AgentState], &mut [BuildingState]) -> Result<(), &'static str>,
    ) -> Result<(), CityError> {
        let City { agents, buildings } = self.city(instance);
        let (mut agents, mut buildings) = (agents.to_vec(), buildings.to_vec());
        change(&mut agents, &mut buildings).map_err(|why| CityError::State(why.into()))?;
        let (scenario, metrics) = (self.scenario(instance), *self.metrics(instance));
        self.restore_with(instance, &agents, &buildings, scenario, metrics)
    }
}
