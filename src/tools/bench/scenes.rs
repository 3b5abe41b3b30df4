//! What benchmarks decide on: observations and allocation states of real episodes, played by the bundle itself.

use sortie_bundle::{Bundle, OwnedAllocationState, Recording};
use sortie_core::{AllocateError, AllocationState, Allocator, Policy};
use sortie_envs::Split;
use sortie_learn::play;
use sortie_methods::alma::evaluate::{EvaluationPlan, evaluate};
use sortie_methods::alma::teams::{DeployedAllocator, PolicyTeam};

use sortie_cli::allocation::Allocation;
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::Failure;
use sortie_cli::observations::RecordingPolicy;

/// The set with the largest teams that are measured, of the environment of another set.
pub(super) fn large_set(own: &ScenarioSetName) -> Result<ScenarioSetName, Failure> {
    ScenarioSetName::parse(&format!("{}/2-8a_2-8b", own.entry().name))
}

/// Episodes that are recorded: some thousand observations.
const EPISODES: usize = 64;

/// Plays episodes of a scenario set under the coordinated rule and records what every agent sees.
pub(super) fn record(
    bundle: &Bundle,
    policy: &mut dyn Policy,
    set: &ScenarioSetName,
    seed: u64,
) -> Result<Recording, Failure> {
    let environment = set.open(Split::Test)?;
    let plan = EvaluationPlan::new(&*environment, EPISODES, seed);
    let mut recorder = RecordingPolicy::new(policy, bundle);
    let mut rule = Allocation::named("coordinated")?.measured();
    evaluate(&plan, &mut PolicyTeam::new(&mut recorder), &mut rule)?;
    Ok(recorder.into_recording())
}

/// The same of a scenario set without subtasks.
pub(super) fn record_without_subtasks(
    bundle: &Bundle,
    policy: &mut dyn Policy,
    set: &ScenarioSetName,
    seed: u64,
) -> Result<Recording, Failure> {
    let environment = set.open(Split::Test)?;
    let mut recorder = RecordingPolicy::new(policy, bundle);
    play::evaluate(&*environment, &mut play::PolicyTeam::new(&mut recorder), EPISODES, seed)?;
    Ok(recorder.into_recording())
}

/// Plays episodes with an allocator and keeps the states that it was asked about.
pub(super) fn allocation_states(
    policy: &mut dyn Policy,
    allocator: impl Allocator,
    set: &ScenarioSetName,
    seed: u64,
) -> Result<Vec<OwnedAllocationState>, Failure> {
    let environment = set.open(Split::Test)?;
    let plan = EvaluationPlan::new(&*environment, EPISODES, seed);
    let mut states = Vec::new();
    let diary = Diary { allocator, states: &mut states };
    evaluate(&plan, &mut PolicyTeam::new(policy), &mut DeployedAllocator(Box::new(diary)))?;
    Ok(states)
}

/// An allocator that keeps what it is asked.
struct Diary<'a, A> {
    allocator: A,
    states: &'a mut Vec<OwnedAllocationState>,
}

impl<A: Allocator> Allocator for Diary<'_, A> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        self.states.push(OwnedAllocationState {
            agents: state.agents,
            tasks: state.tasks,
            rows: state.rows.to_vec(),
            features: state.stride,
            present: state.present,
            entity_task: state.entity_task.to_vec(),
            open_tasks: state.open_tasks,
        });
        self.allocator.allocate(state, allocation)
    }
}
