//! What the learned allocator expects of teams.

use sortie_bundle::Bundle;
use sortie_core::AllocateError;
use sortie_core::allocate::{TaskRelation, TeamQuery, TeamValueNetwork};
use sortie_envs::save_the_city::ENTRY;
use sortie_envs::{Environment, Observation};
use sortie_learn::LearnError;
use sortie_learn::subtasks::{AllocatorNetworks, LearnedAllocator, allocation_state};
use sortie_stage::save_the_city::{TeamValues, candidates};

use crate::allocator::LearnedAllocator as DeployedLearned;
use crate::failure::Failure;
use crate::policy::Backend;
use crate::subject::Subject;
use crate::worlds::relation;

/// Tells what teams, bit a of which stands for agent a, are worth at an open building of a state.
type Ask<'a> =
    dyn FnMut(&dyn Environment, &[u8], usize, &[u64]) -> Result<Vec<f32>, LearnError> + 'a;

/// Asks a team-value network about the teams that are there, and about others.
pub(super) struct TeamValueProbe<'a> {
    ask: Box<Ask<'a>>,
    /// Largest team that the allocator sends to one building.
    team_max: usize,
}

impl<'a> TeamValueProbe<'a> {
    /// Asks the network of a subject, if it learned to value teams.
    pub(super) fn of(subject: &'a Subject) -> Result<Option<Self>, Failure> {
        match subject {
            Subject::Run(run) => {
                let learned = run.method.subtasks().and_then(|subtasks| subtasks.allocator);
                Ok(learned.and_then(Self::of_run))
            }
            Subject::Bundle(bundle) if bundle.allocator_onnx().is_some() => {
                Self::of_bundle(bundle).map(Some)
            }
            Subject::Bundle(_) | Subject::Scripted => Ok(None),
        }
    }

    /// A run's, by the method's own pass.
    fn of_run(learned: LearnedAllocator<'a>) -> Option<Self> {
        let LearnedAllocator { mut allocate, networks, team_max } = learned;
        let ask: Box<Ask<'a>> = Box::new(move |environment, state, task, teams| {
            Ok(allocate.values(environment, state, task, teams))
        });
        let values_teams = matches!(networks, AllocatorNetworks::TeamValue(_));
        values_teams.then_some(Self { ask, team_max: team_max.unwrap_or(usize::MAX) })
    }

    /// A bundle's, by what executes its network in a deployed team.
    fn of_bundle(bundle: &Bundle) -> Result<Self, Failure> {
        let mut learned = DeployedLearned::open(bundle, Backend::Plan)?;
        let ask: Box<Ask<'a>> =
            Box::new(move |environment: &dyn Environment, state: &[u8], task, teams: &[u64]| {
                let state = allocation_state(environment, state);
                let state = state.view();
                let travel = relation(&ENTRY);
                let mut travel = travel.map_err(|failure| LearnError::Team(failure.message))?;
                travel.observe(&state).map_err(refusal)?;
                let mut related = vec![0.0; state.entity_task.len() * travel.columns()];
                travel.write(&state, task, &mut related);
                let network = learned.network();
                let mut network = network.map_err(|failure| LearnError::Team(failure.message))?;
                let value = |&team| {
                    let query = TeamQuery { state: &state, task, team, relation: &related };
                    network.value(&query).map_err(refusal)
                };
                teams.iter().map(value).collect()
            });
        Ok(Self { ask, team_max: bundle.manifest().limits.team_max.into() })
    }

    /// The values in one state, one entry per building, none for closed ones.
    pub(super) fn values(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        allocation: &[u8],
    ) -> Result<Vec<Option<TeamValues>>, LearnError> {
        let mut seen = Observation::default();
        environment.observe(state, 0, 0, &mut seen);
        let Self { ask, team_max } = self;
        of_buildings(&seen, allocation, *team_max, |task, teams| {
            ask(environment, state, task, teams)
        })
    }
}

/// What is known of the teams at each building, and of others that might be there.
fn of_buildings(
    seen: &Observation,
    allocation: &[u8],
    team_max: usize,
    mut ask: impl FnMut(usize, &[u64]) -> Result<Vec<f32>, LearnError>,
) -> Result<Vec<Option<TeamValues>>, LearnError> {
    let agents = seen.agents();
    let team = |task| {
        let assigned = allocation.iter().take(agents).enumerate();
        let here = assigned.filter(|(_, own)| usize::from(**own) == task);
        here.fold(0, |team, (agent, _)| team | 1_u64 << agent)
    };
    let mut at_building = |task| {
        let chosen = team(task);
        let teams = candidates(agents, team_max, chosen);
        Ok(TeamValues::of(&teams, &ask(task, &teams)?, chosen))
    };
    let is_open = |task: &usize| seen.open_tasks >> task & 1 == 1;
    let tasks = (0..seen.tasks()).map(|task| Some(task).filter(is_open));
    tasks.map(|task| task.map(&mut at_building).transpose()).collect()
}

fn refusal(error: AllocateError) -> LearnError {
    LearnError::Team(error.to_string())
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Split, UNASSIGNED};
    use sortie_learn::random::{Purpose, generator};
    use sortie_stage::rounded;

    use super::*;

    /// Some value of a team at a building, of which no two are alike.
    fn value(task: usize, team: u64) -> f32 {
        (team as f32 + 0.5).sin() + task as f32
    }

    #[test]
    fn values_are_those_of_the_teams_that_are_named() {
        let city =
            sortie_envs::open("save-the-city/2-8a_2-8b", Split::Train, 1, &Default::default());
        let (mut city, mut random) = (city.unwrap(), generator(3, Purpose::Rollout, 0));
        let (mut state, mut seen) = (Vec::new(), Observation::default());
        city.reset(0, &mut random);
        city.save(0, &mut state);
        city.observe(&state, 0, 0, &mut seen);
        // The network is asked about open buildings only; this one says that it is not.
        seen.open_tasks &= !0b10;
        let agents = seen.agents();
        let mut allocation = vec![0; agents];
        allocation[0] = UNASSIGNED;

        let ask = |task, teams: &[u64]| {
            assert_ne!(task, 1, "nobody asks about closed buildings");
            Ok(teams.iter().map(|team| value(task, *team)).collect())
        };
        let values = of_buildings(&seen, &allocation, 2, ask).unwrap();
        assert_eq!(values.len(), seen.tasks());
        assert!(values[1].is_none(), "closed buildings have no value");
        let everybody_else = (1 << agents) - 2;
        for (task, chosen) in [(0, everybody_else), (2, 0)] {
            let found = values[task].as_ref().unwrap();
            assert_eq!(found.chosen, rounded(value(task, chosen)));
            assert_eq!(found.nobody, rounded(value(task, 0)));
            assert!(found.others.is_sorted_by(|one, other| one.1 >= other.1));
            assert!(!found.others.is_empty());
            for (agents, known) in &found.others {
                assert!(agents.len() <= 2, "no team over the limit");
                let team = agents.iter().fold(0, |team, agent| team | 1 << agent);
                assert_eq!(*known, rounded(value(task, team)));
            }
        }
    }
}
