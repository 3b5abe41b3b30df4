//! Golden cases: decisions and allocations of what has learned, as every engine is to repeat them.

use std::cell::RefCell;

use sortie_bundle::{
    Golden, GoldenAllocation, GoldenCase, GoldenEpisode, GoldenTick, GoldenValue,
    OwnedAllocationState, OwnedObservation,
};
use sortie_core::options::Pursuit;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_envs::{EntitySet, Environment, SparseRows};

use super::MethodRun;
use crate::act::Act;
use crate::error::Result;
use crate::export::DeployedNetworks;
use crate::play::{PolicyTeam, evaluate};
use crate::subtasks::{
    Allocate, AllocatedTeam, AllocatorNetworks, PolicyAgents, RuleAllocator, Subtasks, ToAllocate,
    allocation_state_turned,
};

/// Golden observations of a bundle.
const GOLDEN_CASES: usize = 256;
/// One of so many decisions becomes golden, so that they come from many episodes.
const GOLDEN_STRIDE: usize = 37;
/// Golden allocations, and of how many one becomes golden.
const CASES: usize = 48;
const STRIDE: usize = 23;
/// Episodes that are golden as a whole, where agents run options.
const WHOLE_EPISODES: u64 = 3;

/// What the method's own passes answer in greedy episodes.
pub(super) fn golden(
    run: &MethodRun<'_>,
    networks: &DeployedNetworks<'_>,
    policy: &mut dyn Policy,
    seed: u64,
) -> Result<Golden> {
    let (environment, spec) = (run.environment, run.environment.spec());
    let mut golden = Golden::default();
    let mut recorder = Recorder::new(spec.shape.features);
    let subtasks = run.method.subtasks();
    recorder.fill(seed, |recorder, seed| {
        let policy = recorder.of(&mut *policy);
        let mut team: Box<dyn Act + '_> = match &subtasks {
            None => Box::new(PolicyTeam::new(policy)),
            Some(subtasks) => {
                let usual = spec.rules.first().map_or("", |rule| &rule.name);
                let (agents, rule) = (PolicyAgents::new(policy), RuleAllocator(usual));
                let interval = subtasks.interval;
                Box::new(AllocatedTeam::new(Box::new(agents), Box::new(rule), interval))
            }
        };
        evaluate(environment, &mut *team, EPISODES, seed).map(drop)
    })?;
    golden.cases = recorder.cases;
    if let Some(subtasks) = subtasks {
        golden.allocations = golden_allocations(subtasks, environment, seed)?;
    } else if matches!(networks, DeployedNetworks::Options { .. }) {
        for index in 0..WHOLE_EPISODES {
            let mut episode = GoldenEpisode::default();
            let mut team = PolicyTeam::new(recorded_episode(&mut *policy, &mut episode));
            evaluate(environment, &mut team, 1, seed.wrapping_add(index))?;
            drop(team);
            golden.episodes.push(episode);
        }
    }
    Ok(golden)
}

/// A policy whose decisions a function takes in its place, with what the agent remembers, and may keep.
pub struct DecoratedPolicy<P, D> {
    policy: P,
    decide: D,
}

impl<P, D> DecoratedPolicy<P, D>
where
    P: Policy,
    D: FnMut(&mut P, &Observation<'_>, &mut [f32]) -> Result<Decision, DecideError>,
{
    /// Decides by this function.
    pub fn new(policy: P, decide: D) -> Self {
        Self { policy, decide }
    }
}

impl<P, D> Policy for DecoratedPolicy<P, D>
where
    P: Policy,
    D: FnMut(&mut P, &Observation<'_>, &mut [f32]) -> Result<Decision, DecideError>,
{
    fn actions(&self) -> usize {
        self.policy.actions()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.policy.utilities(observation, utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn begin_episode(&mut self) -> bool {
        self.policy.begin_episode()
    }

    fn hidden(&self) -> usize {
        self.policy.hidden()
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        (self.decide)(&mut self.policy, observation, hidden)
    }
}

/// Episodes that are played at a time until there is enough that is golden, and how often at most.
pub const EPISODES: usize = 20;
const ROUNDS: u64 = 100;

/// Keeps every so many-th decision: the answer of an agent with an empty memory.
#[derive(Debug)]
pub struct Recorder {
    features: usize,
    decisions: usize,
    /// What was kept.
    pub cases: Vec<GoldenCase>,
}

impl Recorder {
    /// Keeps decisions on rows of so many features.
    pub fn new(features: usize) -> Self {
        Self { features, decisions: 0, cases: Vec::new() }
    }

    /// Plays by seeds from this one on, [`EPISODES`] of each, until enough is kept.
    pub fn fill(
        &mut self,
        seed: u64,
        mut round: impl FnMut(&mut Self, u64) -> Result<()>,
    ) -> Result<()> {
        let mut seeds = (0..ROUNDS).map(|number| seed.wrapping_add(number));
        seeds.try_for_each(|seed| if self.is_full() { Ok(()) } else { round(self, seed) })
    }

    /// A policy of whose decisions some are kept.
    pub fn of<'a>(&'a mut self, policy: impl Policy + 'a) -> impl Policy + 'a {
        DecoratedPolicy::new(policy, |policy, observation, hidden| {
            self.decisions += 1;
            if self.decisions % GOLDEN_STRIDE == 1 && !self.is_full() {
                let mut utilities = vec![0.0; policy.actions()];
                let mut empty = vec![0.0; hidden.len()];
                policy.utilities_with(observation, &mut empty, &mut utilities)?;
                empty.fill(0.0);
                let action = policy.decide_with(observation, &mut empty)?.action;
                let observation = OwnedObservation::copy_of(observation, self.features);
                self.cases.push(GoldenCase { observation, utilities, action });
            }
            policy.decide_with(observation, hidden)
        })
    }

    fn is_full(&self) -> bool {
        self.cases.len() >= GOLDEN_CASES
    }
}

/// Keeps every tick of the episode of a policy that runs options.
fn recorded_episode(policy: impl Policy, episode: &mut GoldenEpisode) -> impl Policy {
    DecoratedPolicy::new(policy, move |policy, observation, hidden| {
        let decision = policy.decide_with(observation, hidden)?;
        let (ones, others) = GoldenTick::sparse(observation.rows);
        if let Some(Pursuit { goal, steps }) = Pursuit::of(hidden) {
            let (goal, chose, action) = (goal as u16, steps == 1, decision.action);
            episode.ticks.push(GoldenTick { ones, others, goal, chose, action });
        }
        Ok(decision)
    })
}

/// Plays under the learned allocator and keeps some of its allocations; none where it proposes: what it draws is another
/// number's.
fn golden_allocations(
    mut subtasks: Subtasks<'_>,
    environment: &dyn Environment,
    seed: u64,
) -> Result<Vec<GoldenAllocation>> {
    let cases = RefCell::default();
    let Some(learned) = subtasks.allocator.take() else { return Ok(cases.take()) };
    if matches!(learned.networks, AllocatorNetworks::Proposals(_)) {
        return Ok(cases.take());
    }
    let recorder = AllocationRecorder {
        allocator: learned.allocate,
        points: matches!(learned.networks, AllocatorNetworks::Pointing(_)),
        allocations: 0,
        cases: &cases,
    };
    let mut team = subtasks.under(Box::new(recorder));
    for seed in (0..ROUNDS).map(|round| seed.wrapping_add(round)) {
        evaluate(environment, &mut team, EPISODES, seed)?;
        if cases.borrow().len() >= CASES {
            break;
        }
    }
    drop(team);
    Ok(cases.take())
}

/// Allocates, and keeps every so many-th allocation.
struct AllocationRecorder<'a> {
    allocator: Box<dyn Allocate + 'a>,
    points: bool,
    allocations: usize,
    cases: &'a RefCell<Vec<GoldenAllocation>>,
}

impl Allocate for AllocationRecorder<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()> {
        let ToAllocate { environment, state, random, allocation } = to;
        let before = allocation.to_vec();
        self.allocator.allocate(ToAllocate { environment, state, random, allocation })?;
        self.allocations += 1;
        if self.allocations % STRIDE == 1 && self.cases.borrow().len() < CASES {
            let mut seen = allocation_state_turned(environment, (state, &before), 0);
            if !self.points {
                // Teams are worth the same whatever was in force, and whatever their agents can do.
                seen.available.clear();
                seen.entity_task[..seen.agents].fill(0);
            }
            let case = self.case((environment, state), seen, allocation);
            self.cases.borrow_mut().push(case);
        }
        Ok(())
    }
}

impl AllocationRecorder<'_> {
    /// The allocation with what it is worth at each open subtask to have its team there, nobody, or everybody.
    fn case(
        &mut self,
        (environment, state): (&dyn Environment, &[u8]),
        seen: OwnedAllocationState,
        allocation: &[u8],
    ) -> GoldenAllocation {
        let allocation = allocation[..seen.agents].to_vec();
        let relations = environment.spec().relations;
        let (mut relation, mut values) = (Vec::new(), Vec::new());
        for task in seen.open() {
            relation.extend(to_task(environment, state, task));
            let assigned = allocation.iter().enumerate();
            let team = assigned.filter(|(_, place)| usize::from(**place) == task);
            let team = team.map(|(agent, _)| 1_u64 << agent).sum();
            let everybody = (0..seen.agents).map(|agent| 1_u64 << agent).sum();
            let teams = [0, team, everybody];
            let worth = self.allocator.values(environment, state, task, &teams);
            let value = |(team, value)| GoldenValue { task, team, value };
            values.extend(teams.into_iter().zip(worth).map(value));
        }
        GoldenAllocation { state: seen, relations, relation, values, allocation }
    }
}

/// How every entity stands to a subtask, in full.
fn to_task(environment: &dyn Environment, state: &[u8], task: usize) -> Vec<f32> {
    let mut rows = SparseRows::default();
    environment.relate(state, 0, task, EntitySet::MAX, &mut rows);
    let mut dense = Vec::new();
    rows.write_all(environment.spec().relations, &mut dense);
    dense
}
