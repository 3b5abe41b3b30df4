//! Networks that value teams: a run's, and a bundle's as deployed.

use sortie_core::AllocateError;
use sortie_core::allocate::{TaskRelation, TeamQuery as DeployedQuery, TeamValueNetwork};
use sortie_envs::save_the_city::ENTRY;
use sortie_learn::LearnError;
use sortie_methods::alma::agents::{UtilityNetwork, UtilityPass};
use sortie_methods::alma::records::team_value::{TeamQuery, TeamValueInput};
use sortie_methods::alma::teams::{Scene, allocation_state};

use crate::allocator::LearnedAllocator;
use crate::worlds::rules::relation;

/// Tells what teams at a building are worth.
pub(super) trait ValueTeams {
    /// The value of every team, bit a of which stands for agent a, at an open building.
    fn values(
        &mut self,
        scene: &Scene<'_>,
        task: usize,
        teams: &[u64],
    ) -> Result<Vec<f32>, LearnError>;
}

/// A run's network, by the trainer's own forward pass.
pub(super) struct RunNetwork<'a> {
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    input: TeamValueInput,
}

impl<'a> RunNetwork<'a> {
    pub(super) fn new(network: &'a UtilityNetwork) -> Self {
        Self { network, pass: UtilityPass::new(network.shape()), input: TeamValueInput::default() }
    }
}

impl ValueTeams for RunNetwork<'_> {
    fn values(
        &mut self,
        scene: &Scene<'_>,
        task: usize,
        teams: &[u64],
    ) -> Result<Vec<f32>, LearnError> {
        let state = scene.state;
        let queries = teams.iter().map(|&team| TeamQuery { state, task, team, turn: 0 });
        let input = self.input.queries(scene.environment, queries);
        Ok(self.pass.forward(self.network, input).to_vec())
    }
}

/// A bundle's network, by what executes it in a deployed team.
pub(super) struct DeployedNetwork(pub(super) LearnedAllocator);

impl ValueTeams for DeployedNetwork {
    fn values(
        &mut self,
        scene: &Scene<'_>,
        task: usize,
        teams: &[u64],
    ) -> Result<Vec<f32>, LearnError> {
        let state = allocation_state(scene.environment, scene.state);
        let state = state.view();
        let travel = relation(&ENTRY);
        let mut travel = travel.map_err(|failure| LearnError::Team(failure.message))?;
        travel.observe(&state).map_err(refusal)?;
        let mut related = vec![0.0; state.entity_task.len() * travel.columns()];
        travel.write(&state, task, &mut related);
        let network = self.0.network();
        let mut network = network.map_err(|failure| LearnError::Team(failure.message))?;
        let value = |&team| {
            let query = DeployedQuery { state: &state, task, team, relation: &related };
            network.value(&query).map_err(refusal)
        };
        teams.iter().map(value).collect()
    }
}

fn refusal(error: AllocateError) -> LearnError {
    LearnError::Team(error.to_string())
}
