//! Who works at what now: proposals of the policy, of which the critic takes the best.

use std::ops::Range;

use sortie_envs::random::below;
use sortie_nn::random::Generator;

use super::critic::{CriticInput, CriticPass};
use super::networks::{AllocationCritic, AllocationPolicy};
use super::proposals::{Noise, ProposalPass};
use super::rows::States;

/// States that are worked on together: enough rows for the matrix products, few enough for the cache.
pub(super) const BLOCK: usize = 10;

/// The columns of both networks that stand for the subtasks, `[T]` each.
///
/// While learning they are shuffled, so that none is tied to a subtask.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskColumns {
    /// Columns of the policy.
    pub policy: Vec<u8>,
    /// Columns of the critic.
    pub critic: Vec<u8>,
}

impl TaskColumns {
    /// The columns of deployment: subtask t has column t.
    pub fn in_order(tasks: usize) -> Self {
        let order: Vec<u8> = (0..).take(tasks).collect();
        Self { policy: order.clone(), critic: order }
    }

    /// Any columns, each at most once.
    pub fn shuffled(tasks: usize, columns: usize, generator: &mut Generator) -> Self {
        let mut shuffle = || shuffled(tasks, columns, generator);
        Self { policy: shuffle(), critic: shuffle() }
    }
}

/// Draws so many of the columns, in random order.
pub(super) fn shuffled(tasks: usize, columns: usize, generator: &mut Generator) -> Vec<u8> {
    let mut all: Vec<u8> = (0..).take(columns).collect();
    for place in 0..tasks {
        let other = place + below(generator, columns - place);
        all.swap(place, other);
    }
    all.truncate(tasks);
    all
}

/// Both networks.
#[derive(Clone, Copy, Debug)]
pub struct AllocationNetworks<'a> {
    /// Proposes.
    pub policy: &'a AllocationPolicy,
    /// Chooses.
    pub critic: &'a AllocationCritic,
}

/// The proposals for some states, P each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proposed {
    /// `[states, P, A]`: the subtask of every agent; absent agents have none.
    pub allocations: Vec<u8>,
    /// `[states, P]`: `log f(b | s)`
    pub log_probabilities: Vec<f32>,
    /// `[states, P]`: the entropy of the choices that led there, summed over the agents.
    pub entropies: Vec<f32>,
}

/// What was decided in some states.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Decided {
    /// `[states, A]`: the proposal of the highest value.
    pub best: Vec<u8>,
    /// `[states, A]`: the first proposal.
    pub first: Vec<u8>,
}

/// Decides; the buffers of one thread.
#[derive(Clone, Debug, Default)]
pub struct Decider {
    proposals: ProposalPass,
    input: CriticInput,
    critic: CriticPass,
}

impl Decider {
    /// Proposes P allocations for every state and takes the best.
    pub fn decide(
        &mut self,
        networks: AllocationNetworks<'_>,
        states: &States,
        columns: &TaskColumns,
        sampling: (usize, Noise<'_>),
    ) -> Decided {
        let length = states.len() * states.agents;
        let mut decided = Decided { best: vec![0; length], first: vec![0; length] };
        for block in blocks(0..states.len()) {
            let start = block.start;
            let policy = networks.policy;
            self.proposals.forward(policy, states, block.clone(), &columns.policy, sampling);
            push_distinct(
                &mut self.input,
                networks.critic,
                states,
                block.clone(),
                (&self.proposals, &columns.critic),
            );
            let values = self.critic.forward(networks.critic, &self.input);
            let best = best_of(&self.proposals, networks.critic, block.len(), values);
            for (local, best) in best.into_iter().enumerate() {
                let place = (start + local) * states.agents..(start + local + 1) * states.agents;
                self.proposals.write(best, &mut decided.best[place.clone()]);
                let first = self.proposals.of_proposal(local, 0);
                self.proposals.write(first, &mut decided.first[place]);
            }
        }
        decided
    }

    /// Proposes P allocations for every state.
    pub fn propose(
        &mut self,
        policy: &AllocationPolicy,
        states: &States,
        columns: &TaskColumns,
        (proposals, noise): (usize, Noise<'_>),
    ) -> Proposed {
        let mut proposed = Proposed::default();
        for block in blocks(0..states.len()) {
            let pass = &mut self.proposals;
            pass.forward(policy, states, block.clone(), &columns.policy, (proposals, noise));
            for index in 0..block.len() * proposals {
                let whole = pass.of_proposal(index / proposals, index % proposals);
                let start = proposed.allocations.len();
                proposed.allocations.resize(start + states.agents, 0);
                pass.write(whole, &mut proposed.allocations[start..]);
                proposed.log_probabilities.push(pass.log_probability(whole));
                proposed.entropies.push(pass.entropy_of(whole));
            }
        }
        proposed
    }

    /// The values of `allocations [states, K, A]`, before PopArt's head.
    pub fn value(
        &mut self,
        critic: &AllocationCritic,
        states: &States,
        columns: &TaskColumns,
        allocations: &[u8],
    ) -> Vec<f32> {
        let per_state = allocations.len() / states.len().max(1);
        let mut values = Vec::new();
        for block in blocks(0..states.len()) {
            self.input.clear();
            for state in block {
                self.input.begin_state(states);
                let own = &allocations[state * per_state..][..per_state];
                for allocation in own.chunks_exact(states.agents) {
                    let columns = &columns.critic;
                    self.input.push(critic.shape(), states, state, allocation, columns);
                }
            }
            values.extend_from_slice(self.critic.forward(critic, &self.input));
        }
        values
    }
}

/// Cuts a range into blocks of states.
pub(super) fn blocks(range: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    let end = range.end;
    range.step_by(BLOCK).map(move |start| start..end.min(start + BLOCK))
}

/// Lists the distinct proposals of a block for the critic.
pub(super) fn push_distinct(
    input: &mut CriticInput,
    critic: &AllocationCritic,
    states: &States,
    block: Range<usize>,
    (proposals, columns): (&ProposalPass, &[u8]),
) {
    let mut allocation = vec![0; states.agents];
    input.clear();
    for (local, state) in block.enumerate() {
        input.begin_state(states);
        for whole in proposals.distinct(local) {
            proposals.write(whole, &mut allocation);
            input.push(critic.shape(), states, state, &allocation, columns);
        }
    }
}

/// The first of the best allocations of every state of a block, to whose distinct ones the critic gave
/// these values, before PopArt's head.
pub(super) fn best_of(
    proposals: &ProposalPass,
    critic: &AllocationCritic,
    states: usize,
    values: &[f32],
) -> Vec<u32> {
    let rises = critic.rises();
    let mut merits = values.iter().map(|raw| rises * raw);
    let best = |local| {
        let mut best = (0, f32::NEG_INFINITY);
        let mut first = None;
        for (whole, merit) in proposals.distinct(local).zip(&mut merits) {
            first = first.or(Some(whole));
            if merit > best.1 {
                best = (whole, merit);
            }
        }
        if best.1 > f32::NEG_INFINITY { best.0 } else { first.unwrap_or(0) }
    };
    (0..states).map(best).collect()
}
