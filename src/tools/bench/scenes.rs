//! What benchmarks decide on: observations and allocation states of real episodes, played by the bundle itself or recorded
//! before.

use sortie_bundle::{Bundle, OwnedAllocationState, Recording};
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::Failure;
use sortie_cli::files::{recording_of, recording_policy};
use sortie_cli::output::tell;
use sortie_core::{AllocateError, AllocationState, Allocator, EntityMask, Observation, Policy};
use sortie_envs::Split;
use sortie_learn::play::{PolicyTeam, evaluate};
use sortie_learn::subtasks::{
    Allocate, AllocatedTeam, DeployedAllocator, PolicyAgents, RuleAllocator,
};

/// The set with the largest teams that are measured, where the environment of another set has it.
pub(super) fn large_set(own: &ScenarioSetName) -> Option<ScenarioSetName> {
    let large = ScenarioSetName::parse(&format!("{}/2-8a_2-8b", own.entry().name)).ok()?;
    large.open(Split::Test).is_ok().then_some(large)
}

/// Episodes that are recorded: some thousand observations.
pub(super) const EPISODES: usize = 64;

/// Plays episodes of a scenario set under the environment's first rule and records what every agent sees.
pub(super) fn record(
    bundle: &Bundle,
    policy: &mut dyn Policy,
    set: &ScenarioSetName,
    seed: u64,
) -> Result<Recording, Failure> {
    let environment = set.open(Split::Test)?;
    let mut recording = recording_of(bundle);
    let mut recorder = recording_policy(policy, &mut recording);
    let usual = environment.spec().rules.first().map_or("", |rule| &rule.name);
    let rule = Box::new(RuleAllocator(usual));
    let interval = bundle.contract().decision_interval;
    let mut team = allocated(&mut recorder, rule, interval);
    evaluate(&*environment, &mut team, EPISODES, seed)?;
    drop(team);
    drop(recorder);
    Ok(recording)
}

/// The same of a scenario set without subtasks.
pub(super) fn record_without_subtasks(
    bundle: &Bundle,
    policy: &mut dyn Policy,
    set: &ScenarioSetName,
    seed: u64,
) -> Result<Recording, Failure> {
    let environment = set.open(Split::Test)?;
    let mut recording = recording_of(bundle);
    let mut team = PolicyTeam::new(recording_policy(policy, &mut recording));
    evaluate(&*environment, &mut team, EPISODES, seed)?;
    drop(team);
    Ok(recording)
}

/// Plays so many episodes at once with an allocator and keeps the states that it was asked about.
pub(super) fn allocation_states(
    policy: &mut dyn Policy,
    allocator: impl Allocator,
    (set, interval): (&ScenarioSetName, u32),
    (episodes, seed): (usize, u64),
) -> Result<Vec<OwnedAllocationState>, Failure> {
    let environment = set.open(Split::Test)?;
    let mut states = Vec::new();
    let diary = Box::new(Diary { allocator, states: &mut states });
    let allocator = Box::new(DeployedAllocator(diary));
    evaluate(&*environment, &mut allocated(policy, allocator, interval), episodes, seed)?;
    Ok(states)
}

/// Agents by a policy, allocated every so many ticks.
fn allocated<'a>(
    policy: &'a mut dyn Policy,
    allocator: Box<dyn Allocate + 'a>,
    interval: u32,
) -> AllocatedTeam<'a> {
    let agents = Box::new(PolicyAgents::new(policy));
    AllocatedTeam::new(agents, allocator, interval)
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
            available: state.available.to_vec(),
        });
        self.allocator.allocate(state, allocation)
    }
}

/// Different observations of a case, which are taken in turn.
const OBSERVATIONS: usize = 256;
/// Entities of a frame whose mask is forced open.
const ALL: usize = 11;
/// Visible entities of the usual decision.
const FEW: usize = 4;

/// Observations that are decided on in turn.
pub(super) struct Case<'a> {
    pub(super) name: String,
    observations: Vec<Observation<'a>>,
}

/// Frames of so many entities with the mask forced open: what is masked by subtask never shows as many.
pub(super) fn all_visible(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().flat_map(Recording::observations);
    let full = observations.filter(|seen| seen.rows.len() == ALL * seen.stride);
    let open = full.map(|seen| Observation { visible: EntityMask::first(ALL), ..seen });
    Case { name: format!("N = {ALL}, all visible"), observations: some(open.collect()) }
}

/// Recorded masks that show so many entities.
pub(super) fn few_visible(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().flat_map(Recording::observations);
    let few = observations.filter(|seen| seen.visible.len() == FEW);
    Case { name: format!("N = {FEW}"), observations: some(few.collect()) }
}

/// All recorded masks of the bundle's own scenario set.
pub(super) fn recorded(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().take(1).flat_map(Recording::observations);
    let observations = some(observations.collect());
    let visible: usize = observations.iter().map(|seen| seen.visible.len()).sum();
    let mean = visible as f64 / observations.len().max(1) as f64;
    Case { name: format!("recorded masks, {mean:.1} entities"), observations }
}

/// Some of many, from all parts of the episodes.
pub(super) fn some<T>(all: Vec<T>) -> Vec<T> {
    let step = (all.len() / OBSERVATIONS).max(1);
    all.into_iter().step_by(step).take(OBSERVATIONS).collect()
}

impl Case<'_> {
    pub(super) fn holds_any(&self, bundle: &str) -> bool {
        if self.observations.is_empty() {
            tell!("note: no observation of {bundle} for `{}`", self.name);
        }
        !self.observations.is_empty()
    }

    pub(super) fn decide(&self, policy: &mut dyn Policy, call: usize) {
        let observation = &self.observations[call % self.observations.len()];
        let decision = policy.decide(observation);
        std::hint::black_box(decision.expect("observations of episodes can be decided on"));
    }
}
