//! What the learned allocator expects of teams.

use sortie_core::AllocateError;
use sortie_core::allocate::{TaskRelation, TeamQuery as DeployedQuery, TeamValueNetwork};
use sortie_envs::save_the_city::ENTRY;
use sortie_learn::LearnError;
use sortie_methods::alma::agents::{UtilityNetwork, UtilityPass};
use sortie_methods::alma::export::LearnedAllocator;
use sortie_methods::alma::records::team_value::{TeamQuery, TeamValueInput};
use sortie_methods::alma::teams::{Scene, allocation_state};
use sortie_stage::save_the_city::{TeamValues, candidates};

use crate::allocator::LearnedAllocator as DeployedLearned;
use crate::failure::Failure;
use crate::policy::Backend;
use crate::subject::Subject;
use crate::worlds::relation;

/// Asks a team-value network about the teams that are there, and about others.
pub(super) struct TeamValueProbe<'a> {
    network: Box<dyn ValueTeams + 'a>,
    /// Largest team that the allocator sends to one building.
    team_max: usize,
}

impl<'a> TeamValueProbe<'a> {
    /// Asks the network of a subject, if it learned an allocator.
    pub(super) fn of(subject: &'a Subject) -> Result<Option<Self>, Failure> {
        match subject {
            Subject::Run(run) => Ok(LearnedAllocator::of(run).map(Self::of_run)),
            Subject::Bundle(bundle) if bundle.allocator_onnx().is_some() => {
                let network = DeployedNetwork(DeployedLearned::open(bundle, Backend::Plan)?);
                let team_max = bundle.manifest().limits.team_max.into();
                Ok(Some(Self { network: Box::new(network), team_max }))
            }
            Subject::Bundle(_) | Subject::Scripted => Ok(None),
        }
    }

    fn of_run(LearnedAllocator { network, team_max }: LearnedAllocator<'a>) -> Self {
        let pass = UtilityPass::new(network.shape());
        let network = RunNetwork { network, pass, input: TeamValueInput::default() };
        Self { network: Box::new(network), team_max }
    }

    /// The values in one state, one entry per building, none for closed ones.
    pub(super) fn values(
        &mut self,
        scene: &Scene<'_>,
    ) -> Result<Vec<Option<TeamValues>>, LearnError> {
        let agents = scene.seen.agents();
        let team = |task| {
            let assigned = scene.allocation.iter().take(agents).enumerate();
            let here = assigned.filter(|(_, own)| usize::from(**own) == task);
            here.fold(0, |team, (agent, _)| team | 1_u64 << agent)
        };
        let tasks = 0..scene.seen.tasks();
        tasks
            .map(|task| {
                let is_open = scene.seen.open_tasks >> task & 1 == 1;
                is_open.then(|| self.at_building(scene, task, team(task))).transpose()
            })
            .collect()
    }

    fn at_building(
        &mut self,
        scene: &Scene<'_>,
        task: usize,
        chosen: u64,
    ) -> Result<TeamValues, LearnError> {
        let agents = scene.seen.agents();
        let teams = candidates(agents, self.team_max, chosen);
        let values = self.network.values(scene, task, &teams)?;
        Ok(TeamValues::of(&teams, &values, chosen))
    }
}

/// Tells what teams at a building are worth.
trait ValueTeams {
    /// The value of every team, bit a of which stands for agent a, at an open building.
    fn values(
        &mut self,
        scene: &Scene<'_>,
        task: usize,
        teams: &[u64],
    ) -> Result<Vec<f32>, LearnError>;
}

/// A run's network, by the trainer's own forward pass.
struct RunNetwork<'a> {
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    input: TeamValueInput,
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
struct DeployedNetwork(DeployedLearned);

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

#[cfg(test)]
mod tests {
    use sortie_envs::{EntitySet, Observation, Split, UNASSIGNED};
    use sortie_learn::random::{Purpose, generator};
    use sortie_methods::alma::agents::{UtilityNetwork, UtilityPass, UtilityShape};
    use sortie_methods::alma::records::team_value::{TeamColumns, TeamQuery, TeamValueInput};
    use sortie_stage::rounded;

    use super::*;

    #[test]
    fn values_are_those_of_the_network_for_the_teams_that_are_named() {
        let city =
            sortie_envs::open("save-the-city/2-8a_2-8b", Split::Train, 1, &Default::default());
        let (mut city, mut random) = (city.unwrap(), generator(3, Purpose::Rollout, 0));
        let (mut state, mut seen) = (Vec::new(), Observation::default());
        city.reset(0, &mut random);
        city.save(0, &mut state);
        city.observe(&state, 0, EntitySet::MAX, &mut seen);
        // The network is asked about open buildings only; this one says that it is not.
        seen.open_tasks &= !0b10;
        let (environment, agents) = (&*city, seen.agents());
        let input = TeamColumns::of(environment.spec()).count();
        let shape = UtilityShape { input, width: 16, heads: 2, base: 8, actions: 1, skip: false };
        let mut weights = generator(1, Purpose::Weights, 0);
        let network = UtilityNetwork::initialise(shape, 8.0, &mut weights);
        let mut allocation = vec![0; agents];
        allocation[0] = UNASSIGNED;

        let mut probe = TeamValueProbe::of_run(LearnedAllocator { network: &network, team_max: 2 });
        let scene = Scene {
            world: 0,
            environment,
            state: &state,
            seen: &seen,
            allocation: &allocation,
            last_actions: &[],
            strategies: &[],
        };
        let values = probe.values(&scene).unwrap();
        assert_eq!(values.len(), seen.tasks());
        assert!(values[1].is_none(), "closed buildings have no value");

        let ask = |task, team| {
            let mut input = TeamValueInput::default();
            let query = TeamQuery { state: &state, task, team, turn: 0 };
            let mut pass = UtilityPass::new(shape);
            rounded(pass.forward(&network, input.queries(environment, std::iter::once(query)))[0])
        };
        let everybody_else = (1 << agents) - 2;
        for (task, chosen) in [(0, everybody_else), (2, 0)] {
            let found = values[task].as_ref().unwrap();
            assert_eq!(found.chosen, ask(task, chosen));
            assert_eq!(found.nobody, ask(task, 0));
            assert!(found.others.is_sorted_by(|one, other| one.1 >= other.1));
            for (agents, value) in &found.others {
                assert!(agents.len() <= 2, "no team over the limit");
                let team = agents.iter().fold(0, |team, agent| team | 1 << agent);
                assert_eq!(*value, ask(task, team));
            }
        }
    }
}
