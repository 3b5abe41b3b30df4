//! Allocators that can be measured.

use sortie_bundle::OwnedAllocationState;
use sortie_core::{Allocator, EntityMask};
use sortie_envs::save_the_city::{City, FEATURES, UNASSIGNED, write_agent_row, write_building_row};
use sortie_nn::random::Generator;

use super::Allocate;
use sortie_learn::LearnError;

/// A deployed allocator, on what it would see of a city.
pub struct DeployedAllocator<'a>(pub Box<dyn Allocator + 'a>);

impl Allocate for DeployedAllocator<'_> {
    fn allocate(
        &mut self,
        city: City<'_>,
        _: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let mut state = allocation_state(city);
        // What a policy proposes depends on what was in force.
        for (tasks, last) in state.entity_task.iter_mut().zip(&allocation[..state.agents]) {
            *tasks = 1_u32.checked_shl((*last).into()).unwrap_or(0);
        }
        allocation.fill(UNASSIGNED);
        let team = &mut allocation[..state.agents];
        self.0.allocate(&state.view(), team).map_err(|error| LearnError::Team(error.to_string()))
    }
}

/// All that an allocator sees of a city; agents come without their last allocation.
pub fn allocation_state(city: City<'_>) -> OwnedAllocationState {
    let (agents, tasks) = (city.agents.len(), city.buildings.len());
    let mut rows = vec![0.0; (agents + tasks) * FEATURES];
    let mut each = rows.chunks_exact_mut(FEATURES);
    city.agents.iter().zip(&mut each).for_each(|(agent, row)| write_agent_row(agent, row));
    city.buildings.iter().zip(&mut each).for_each(|(b, row)| write_building_row(b, row));
    OwnedAllocationState {
        agents,
        tasks,
        rows,
        features: FEATURES,
        present: EntityMask::first(agents + tasks),
        entity_task: (0..agents).map(|_| 0).chain((0..tasks).map(|task| 1 << task)).collect(),
        open_tasks: city.open_tasks(),
    }
}
