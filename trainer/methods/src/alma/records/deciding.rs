//! Who works where while learning: allocations of an episode, explored, cut into segments.

use serde::{Deserialize, Serialize};
use sortie_envs::random::{below, chance, member};
use sortie_envs::{Environment, Observation, Spec, Step, members};
use sortie_learn::random::by_weight;
use sortie_learn::subtasks::{NO_ACTION, Place, RuleAllocator, ToAllocate};
use sortie_learn::{LearnError, Transition};
use sortie_nn::random::Generator;

use super::config::{AllocatorConfig, Config, LEARNED};
use super::replay::Moment;
use super::team_value::{Segments, TeamSearch};
use crate::alma::agents::UtilityView;

/// The first rules of an environment stand in for an allocator that has not begun to decide, so many of them.
const STAND_INS: usize = 2;

/// Who allocates in an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Allocation {
    /// The allocator of the run.
    Learned,
    /// The environment's rule of this number.
    Rule(u8),
}

impl Allocation {
    /// The rule that allocates, the first where none was asked for.
    fn rule(self) -> usize {
        match self {
            Self::Learned => 0,
            Self::Rule(number) => number.into(),
        }
    }
}

/// What one episode remembers between its decisions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Decisions {
    instance: usize,
    allocation_by: Allocation,
    /// The rule that decides while the learned allocator learns but does not decide.
    stand_in: Allocation,
    /// The allocation of the step before; nothing at the begin of an episode.
    pub(super) before: Vec<u8>,
    segment: Option<Segment>,
}

/// The steps since a decision that the allocator learns from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Segment {
    /// The state and what was decided, as a [`Moment`]'s bytes.
    decision: Vec<u8>,
    /// Discounted sum `[T]` of each task's rewards since.
    rewards: Vec<f64>,
    /// Discount of what follows, a power of the discount of a step.
    discount: f32,
}

impl Decisions {
    pub(super) fn new(instance: usize) -> Self {
        let (allocation_by, stand_in) = (Allocation::Learned, Allocation::Rule(0));
        Self { instance, allocation_by, stand_in, before: Vec::new(), segment: None }
    }

    /// A new episode begins.
    pub(super) fn restart(&mut self, deciding: &Deciding, generator: &mut Generator) {
        self.allocation_by = deciding.draw(generator);
        self.stand_in = Allocation::Rule(below(generator, deciding.stand_ins) as u8);
        self.before.clear();
        self.segment = None;
    }

    /// Notes what a step earned, and ends the segment where it ended the episode.
    pub(super) fn remember(
        &mut self,
        transition: &Transition<'_>,
        discount: f32,
        segments: Option<&mut Segments>,
    ) {
        let Some(segment) = &mut self.segment else { return };
        for (sum, reward) in segment.rewards.iter_mut().zip(transition.task_rewards) {
            *sum += f64::from(segment.discount) * *reward;
        }
        segment.discount *= discount;
        if transition.step.done()
            && let (Some(segment), Some(segments)) = (self.segment.take(), segments)
        {
            self.keep(transition.environment, segment, transition.step, segments);
        }
    }

    /// Ends the segment of the decision before and begins that of the one just made.
    fn begin_segment(
        &mut self,
        (environment, state): (&dyn Environment, &[u8]),
        allocation: &[u8],
        segments: &mut Segments,
    ) {
        if let Some(segment) = self.segment.take() {
            self.keep(environment, segment, Step::default(), segments);
        }
        let none = &vec![NO_ACTION; allocation.len()];
        let decision = Moment { state, allocation, last_actions: none, actions: none }.bytes();
        let rewards = vec![0.0; environment.spec().shape.tasks];
        self.segment = Some(Segment { decision, rewards, discount: 1.0 });
    }

    fn keep(
        &self,
        environment: &dyn Environment,
        segment: Segment,
        step: Step,
        segments: &mut Segments,
    ) {
        let kept = Transition {
            environment,
            instance: self.instance,
            state: &segment.decision,
            actions: &[],
            step,
            task_rewards: &segment.rewards,
            agent_rewards: &[],
            next: &[],
        };
        segments.push_noted(&kept, segment.discount);
    }
}

#[derive(Debug)]
pub(super) struct Deciding {
    /// Who allocates in a training episode, by weight.
    allocators: Vec<(Allocation, f64)>,
    /// Rules that stand in for the learned allocator.
    stand_ins: usize,
    /// Largest team that it sends to one subtask.
    team_max: usize,
    allocator: AllocatorConfig,
    pub(super) search: TeamSearch,
}

impl Deciding {
    pub(super) fn new(config: &Config, spec: &Spec) -> Self {
        let (allocation, allocator) = (&config.allocation, config.allocator.clone());
        let search = TeamSearch::new(allocation.team_max);
        // Rules that the environment does not have are of no weight.
        let by_number = |(name, weight): (&str, f64)| {
            let rule =
                RuleAllocator(name).number(spec).map(|number| Allocation::Rule(number as u8));
            Some((if name == LEARNED { Allocation::Learned } else { rule.ok()? }, weight))
        };
        Self {
            allocators: allocation.weights().into_iter().filter_map(by_number).collect(),
            stand_ins: spec.rules.len().clamp(1, STAND_INS),
            team_max: allocation.team_max,
            allocator,
            search,
        }
    }

    /// Draws who allocates in an episode.
    fn draw(&self, generator: &mut Generator) -> Allocation {
        let weights: Vec<f64> = self.allocators.iter().map(|(_, weight)| *weight).collect();
        self.allocators[by_weight(generator, &weights)].0
    }

    /// Decides in a state of an episode.
    ///
    /// `network` decides where the learned allocator is to, or a rule in its stead. `segments` takes the
    /// segment that ends; without them the allocator learns nothing, and nothing is tried out.
    pub(super) fn decide(
        &mut self,
        episode: &mut Decisions,
        at: (&dyn Environment, &[u8]),
        place: &mut Place,
        generator: &mut Generator,
        network: Option<UtilityView<'_>>,
        segments: Option<&mut Segments>,
    ) -> Result<(), LearnError> {
        let (environment, state) = at;
        let (learns, allocation) = (segments.is_some(), &mut place.allocation[..]);
        match (episode.allocation_by, network) {
            (Allocation::Learned, Some(network)) => {
                let to = ToAllocate { environment, state, random: generator, allocation };
                self.search.allocate(network, to)?;
            }
            (by, _) => {
                let by = if by == Allocation::Learned && learns { episode.stand_in } else { by };
                environment.allocate(by.rule(), state, generator, allocation);
            }
        }
        let explores = learns && episode.allocation_by == Allocation::Learned;
        if explores && chance(generator, self.allocator.moved_decisions) {
            move_some(&place.seen, self.allocator.moved, self.team_max, generator, allocation);
        }
        if let Some(segments) = segments {
            episode.begin_segment(at, allocation, segments);
        }
        Ok(())
    }
}

/// Sends a share of the agents to random open subtasks, except where the team is full.
fn move_some(
    seen: &Observation,
    share: f64,
    team_max: usize,
    generator: &mut Generator,
    allocation: &mut [u8],
) {
    let open = seen.open_tasks;
    for agent in members(seen.acting().into()) {
        if chance(generator, share)
            && open != 0
            && let Some(task) = member(generator, open)
        {
            let task = task as u8;
            if allocation.iter().filter(|own| **own == task).count() < team_max {
                allocation[agent] = task;
            }
        }
    }
}

#[cfg(test)]
mod tests;
