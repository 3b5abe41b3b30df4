//! Who works at what now: proposals of the policy, of which the critic takes the best.

use std::ops::Range;

use sortie_envs::random::below;
use sortie_nn::random::Generator;
use sortie_nn::tape::Tape;

use super::networks::{AllocationCritic, AllocationPolicy, CriticInput};
use super::proposals::{Noise, Proposals};
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

/// What was decided in some states.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Decided {
    /// `[states, A]`: the proposal of the highest value.
    pub best: Vec<u8>,
    /// `[states, A]`: the first proposal.
    pub first: Vec<u8>,
}

/// Decides; the buffers of one thread.
#[derive(Debug, Default)]
pub struct Decider {
    pub(super) policy_tape: Tape,
    pub(super) critic_tape: Tape,
    pub(super) input: CriticInput,
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
        let mut decided = Decided::default();
        for block in blocks(0..states.len()) {
            let Self { policy_tape, critic_tape, input } = self;
            let own = (states, block);
            let policy = networks.policy;
            let proposals = Proposals::draw(policy_tape, policy, own, &columns.policy, sampling);
            let own = (states, &*columns.critic);
            let (t, values) = networks.critic.value(critic_tape, input, own, proposals.distinct());
            let best = best_of(&proposals, networks.critic, t.values(values));
            for (local, best) in best.into_iter().enumerate() {
                proposals.write(best, &mut decided.best);
                proposals.write(proposals.of_proposal(local, 0), &mut decided.first);
            }
        }
        decided
    }
}

/// Cuts a range into blocks of states.
pub(super) fn blocks(range: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    let end = range.end;
    range.step_by(BLOCK).map(move |start| start..end.min(start + BLOCK))
}

/// The first of the best allocations of every state of a block, to whose distinct ones the critic gave
/// these values, before PopArt's head.
pub(super) fn best_of(
    proposals: &Proposals<'_>,
    critic: &AllocationCritic,
    values: &[f32],
) -> Vec<u32> {
    let rises = critic.rises();
    let mut merits = values.iter().map(|raw| rises * raw);
    let best = |local| {
        let all = proposals.distinct_of(local);
        let mut best = (all.start, f32::NEG_INFINITY);
        for (whole, merit) in all.zip(&mut merits) {
            if merit > best.1 {
                best = (whole, merit);
            }
        }
        best.0
    };
    (0..proposals.block.len()).map(best).collect()
}
