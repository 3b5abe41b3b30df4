//! What is asked of a team beside what it does: whom agents attend to, what they make of their actions, what teams are worth.

use sortie_bundle::Bundle;
use sortie_core::allocate::{TaskRelation, TeamQuery, TeamValueNetwork};
use sortie_core::choose::masked_argmax;
use sortie_core::{AllocateError, AllocationState, Allocator, Policy, UNASSIGNED};
use sortie_envs::Environment;
use sortie_learn::LearnError;
use sortie_learn::draft::DecoratedPolicy;
use sortie_learn::subtasks::{AllocatorNetworks, LearnedAllocator, allocation_state};
use sortie_pages::TeamValueProbe;
use sortie_plans::{AttentionLayers, AttentionProbe, roles_of};
use sortie_stage::{FrameRelation, Thought};

use crate::allocator::LearnedAllocator as DeployedLearned;
use crate::environment::entry_of;
use crate::failure::{Exit, Failure};
use crate::policy::Backend;
use crate::subject::Subject;
use crate::tools::compiler;
use crate::worlds::relation;

/// What tells whom a bundle's agents attend to; none where they attend to nobody that is known.
pub(crate) fn attention_of(bundle: &Bundle) -> Result<Option<AttentionLayers>, Failure> {
    let attends = bundle.options().is_none() && roles_of(bundle)?.is_none();
    Ok(attends.then(|| compiler().attention(bundle.agent_onnx())).transpose()?)
}

/// A bundle's policy as deployed that notes every thought, in the order of the decisions; with the attention read from its
/// graph, where the network attends to anything that is known.
pub(super) fn thinking_aloud<'a>(
    bundle: &Bundle,
    policy: Box<dyn Policy + 'a>,
    thoughts: &'a mut Vec<Thought>,
) -> Result<impl Policy + 'a, Failure> {
    let features = usize::from(bundle.contract().features);
    let mut probe = attention_of(bundle)?.map(|layers| AttentionProbe::new(layers, features));
    Ok(DecoratedPolicy::new(policy, move |policy, observation, _| {
        let mut utilities = vec![0.0; policy.actions()];
        policy.utilities(observation, &mut utilities)?;
        let attention = probe.as_mut().map(|probe| probe.by_entity(observation));
        thoughts.push(Thought::new(&utilities, attention.transpose()?.unwrap_or_default()));
        masked_argmax(&utilities, observation.available)
    }))
}

/// Asks the network of a subject, if it learned to value teams.
pub(super) fn values_of(subject: &Subject) -> Result<Option<TeamValueProbe<'_>>, Failure> {
    match subject {
        Subject::Run(run) => {
            let learned = run.method.subtasks().and_then(|subtasks| subtasks.allocator);
            Ok(learned.and_then(values_of_run))
        }
        Subject::Bundle(bundle) if bundle.allocator_onnx().is_some() => {
            values_of_bundle(bundle).map(Some)
        }
        Subject::Bundle(_) | Subject::Scripted => Ok(None),
    }
}

/// A run's, by the method's own pass.
fn values_of_run(learned: LearnedAllocator<'_>) -> Option<TeamValueProbe<'_>> {
    let LearnedAllocator { mut allocate, networks, team_max } = learned;
    let values_teams = matches!(networks, AllocatorNetworks::TeamValue(_));
    values_teams.then(|| TeamValueProbe {
        ask: Box::new(move |environment, state, task, teams| {
            Ok(allocate.values(environment, state, task, teams))
        }),
        team_max: team_max.unwrap_or(usize::MAX),
    })
}

/// A bundle's, by what executes its network in a deployed team.
fn values_of_bundle(bundle: &Bundle) -> Result<TeamValueProbe<'_>, Failure> {
    let mut network = TeamNetwork::open(bundle)?;
    let ask = move |environment: &dyn Environment, state: &[u8], task, teams: &[u64]| {
        let state = allocation_state(environment, state);
        let mut of_state = network.of_state(state.view()).map_err(failed)?;
        of_state(task, teams).map_err(refused)
    };
    let team_max = bundle.manifest().limits.team_max.into();
    Ok(TeamValueProbe { ask: Box::new(ask), team_max })
}

/// A bundle's network that values teams.
pub(crate) struct TeamNetwork {
    learned: DeployedLearned,
    related: FrameRelation,
}

/// The agents that are there and work on a subtask, as bits.
pub(crate) fn team_on(task: usize, tasks: &[u8], state: &AllocationState<'_>) -> u64 {
    let given = tasks.iter().take(state.agents).enumerate();
    let members = given
        .filter(|(member, given)| usize::from(**given) == task && state.present.contains(*member));
    members.fold(0, |team, (member, _)| team | 1 << member)
}

/// What teams are worth to a subtask.
pub(crate) type OfState<'a> = dyn FnMut(usize, &[u64]) -> Result<Vec<f32>, AllocateError> + 'a;

/// What all teams of an allocation are worth together.
pub(crate) fn total(
    values: &mut OfState<'_>,
    state: &AllocationState<'_>,
    tasks: &[u8],
) -> Result<f64, AllocateError> {
    let mut sum = 0.0;
    for task in (0..state.tasks).filter(|task| state.open_tasks >> task & 1 == 1) {
        let value = values(task, &[team_on(task, tasks, state)])?;
        sum += value.first().copied().map_or(0.0, f64::from);
    }
    Ok(sum)
}

impl TeamNetwork {
    pub(crate) fn open(bundle: &Bundle) -> Result<Self, Failure> {
        let related = relation(entry_of(bundle)?)?;
        Ok(Self { learned: DeployedLearned::open(bundle, Backend::Plan)?, related })
    }

    /// The allocation that the search finds by it, a subtask for every agent.
    pub(crate) fn best(&mut self, state: &AllocationState<'_>) -> Result<Vec<u8>, Failure> {
        let mut tasks = vec![UNASSIGNED; state.agents];
        let mut allocator = self.learned.allocator()?;
        let found = allocator.allocate(state, &mut tasks);
        found.map_err(|error| Failure::new(Exit::BadData, error.to_string()))?;
        Ok(tasks)
    }

    /// What an allocation is worth: the values of the teams on all open subtasks together.
    pub(crate) fn worth(
        &mut self,
        state: AllocationState<'_>,
        tasks: &[u8],
    ) -> Result<f64, Failure> {
        let refused = |error: AllocateError| Failure::new(Exit::BadData, error.to_string());
        total(&mut *self.of_state(state)?, &state, tasks).map_err(refused)
    }

    /// What teams are worth in a state.
    pub(crate) fn of_state<'a>(
        &'a mut self,
        state: AllocationState<'a>,
    ) -> Result<Box<OfState<'a>>, Failure> {
        let Self { learned, related } = self;
        let refused = |error: AllocateError| Failure::new(Exit::BadData, error.to_string());
        related.observe(&state).map_err(refused)?;
        let mut network = learned.network()?;
        Ok(Box::new(move |task, teams| {
            let mut rows = vec![0.0; state.entity_task.len() * related.columns()];
            related.write(&state, task, &mut rows);
            let value =
                |&team| network.value(&TeamQuery { state: &state, task, team, relation: &rows });
            teams.iter().map(value).collect()
        }))
    }
}

fn failed(failure: Failure) -> LearnError {
    LearnError::Team(failure.message)
}

fn refused(error: AllocateError) -> LearnError {
    LearnError::Team(error.to_string())
}
