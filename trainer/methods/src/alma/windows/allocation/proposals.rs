//! Allocations proposed by the policy, with their probabilities, and the way back to its weights.
//!
//! Dissertation section 7.2.2 and the public code's autoregressive pointer policy, rewritten so that every
//! distinct thing is computed once: see [`super::trunk`] and [`super::teams`].

use std::ops::Range;

use sortie_core::internal::math::exp;
use sortie_envs::random::unit;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::random::Generator;

use super::networks::{AllocationPolicy, PolicyParts};
use super::rows::States;
use super::teams::{Prefix, Teams, Tree};
use super::trunk::{Block, NONE, Trunk};
use crate::alma::windows::NO_TASK;

/// What decides between the possible choices.
#[derive(Clone, Copy, Debug)]
pub enum Noise<'a> {
    /// Draws each state's choices from a generator of its own, so that it does not matter which states
    /// are worked on together.
    Seeded {
        /// The seed of all states.
        seed: u64,
        /// Whether the first proposal takes the likeliest choices instead.
        greedy_first: bool,
    },
    /// Adds `[states, P, A, T]` numbers to the log-probabilities and takes the largest.
    Gumbel(&'a [f32]),
    /// Takes the allocations `[states, P, A]` as they are; choices of absent agents are not looked at.
    Given(&'a [u8]),
}

/// The proposals of a block of states; buffers of one worker.
#[derive(Clone, Debug, Default)]
pub(super) struct ProposalPass {
    block: Block,
    trunk: Trunk,
    teams: Teams,
    tree: Tree,
    proposals: usize,
    generators: Vec<Generator>,
}

impl ProposalPass {
    /// Proposes `proposals` allocations for each of a range of states; `columns [T]` are task columns.
    pub(super) fn forward(
        &mut self,
        policy: &AllocationPolicy,
        states: &States,
        range: Range<usize>,
        columns: &[u8],
        (proposals, noise): (usize, Noise<'_>),
    ) {
        let (shape, view) = (policy.shape(), policy.parts());
        self.proposals = proposals;
        self.block.fill(shape, states, range.clone(), columns);
        let vectors = self.teams.begin(shape, &self.block);
        self.trunk.forward(shape, &view, &self.block, vectors);
        self.teams.count_agents(shape, &view, self.trunk.agents(shape, &self.block));
        self.tree.begin(proposals, states.tasks, &self.block.open);
        self.generators.clear();
        if let Noise::Seeded { seed, .. } = noise {
            let own = |state: usize| generator(seed, Purpose::Proposals, state as u64);
            self.generators.extend(range.map(own));
        }
        let mut start = 0;
        let deepest = self.block.levels.iter().copied().max().unwrap_or(0);
        for level in 0..deepest {
            let end = self.tree.prefixes.len();
            self.value_choices(policy, start..end);
            (0..self.block.len()).for_each(|local| self.choose(local, level, noise));
            self.teams.grow(shape, &view, &self.trunk.updates);
            start = end;
        }
    }

    /// Whether a prefix has allocated all agents of its state.
    fn is_whole(&self, prefix: &Prefix) -> bool {
        prefix.level as usize == self.block.levels[prefix.state as usize]
    }

    /// The row of the next agent of a prefix that is not whole.
    fn next_row(&self, prefix: &Prefix) -> u32 {
        self.block.agent_rows[prefix.state as usize * self.block.agents + prefix.level as usize]
    }

    /// Computes the log-probabilities of the next choices of some prefixes.
    fn value_choices(&mut self, policy: &AllocationPolicy, prefixes: Range<usize>) {
        let shape = policy.shape();
        for index in prefixes.clone() {
            let prefix = self.tree.prefixes[index];
            if self.is_whole(&prefix) {
                continue;
            }
            let row = self.next_row(&prefix);
            for team in self.tree.teams(index).iter().filter(|team| **team != NONE) {
                self.teams.ask(*team, prefix.level as usize, row);
            }
        }
        self.teams.answer(shape, self.trunk.agents(shape, &self.block));
        for index in prefixes {
            let prefix = self.tree.prefixes[index];
            if self.is_whole(&prefix) {
                continue;
            }
            for task in 0..self.block.tasks {
                let team = self.tree.teams(index)[task];
                if team != NONE {
                    let logit = self.teams.logit(team, prefix.level as usize);
                    self.tree.log_probabilities_mut(index)[task] = logit;
                }
            }
            log_softmax(self.tree.log_probabilities_mut(index));
        }
    }

    /// Lets all proposals of a state choose for their next agent.
    fn choose(&mut self, local: usize, level: usize, noise: Noise<'_>) {
        let levels = self.block.levels[local];
        if level >= levels {
            return;
        }
        let slot = usize::from(self.block.slots[local * self.block.agents + level]);
        for proposal in 0..self.proposals {
            let index = local * self.proposals + proposal;
            let chances = self.tree.log_probabilities(self.tree.at[index] as usize);
            let global = self.block.states.start * self.proposals + index;
            let agent = global * self.block.agents + slot;
            let task = match noise {
                Noise::Seeded { greedy_first: true, .. } if proposal == 0 => largest(chances),
                Noise::Seeded { .. } => draw(chances, unit(&mut self.generators[local])),
                Noise::Gumbel(noise) => {
                    let noise = &noise[agent * chances.len()..];
                    largest_of(chances.iter().zip(noise).map(|(chance, noise)| chance + noise))
                }
                Noise::Given(allocations) => usize::from(allocations[agent]),
            };
            let row = self.block.agent_rows[local * self.block.agents + level];
            let teams = &mut self.teams;
            let followed = level + 1 < levels;
            let join = |team| if followed { teams.join(team, level, row) } else { team };
            self.tree.choose(index, task, join);
        }
    }

    /// The distinct allocations of a state of the block, and for each proposal which one it is.
    pub(super) fn distinct(&self, local: usize) -> impl Iterator<Item = u32> {
        let range = self.whole(local);
        range.start as u32..range.end as u32
    }

    /// Whole prefixes of a state stand behind each other, as they arise together.
    fn whole(&self, local: usize) -> Range<usize> {
        let at = &self.tree.at[local * self.proposals..][..self.proposals];
        let first = at.iter().min().copied().unwrap_or(0);
        let last = at.iter().max().map_or(0, |last| last + 1);
        first as usize..last as usize
    }

    /// The distinct allocation that a proposal of a state is.
    pub(super) fn of_proposal(&self, local: usize, proposal: usize) -> u32 {
        self.tree.at[local * self.proposals + proposal]
    }

    /// Writes an allocation `[A]`; absent agents have no subtask.
    pub(super) fn write(&self, whole: u32, allocation: &mut [u8]) {
        allocation.fill(NO_TASK);
        for prefix in self.tree.way_back(whole) {
            let place = prefix.state as usize * self.block.agents + prefix.level as usize - 1;
            allocation[usize::from(self.block.slots[place])] = prefix.task;
        }
    }

    /// The log-probability `log f(b | s)` of an allocation.
    pub(super) fn log_probability(&self, whole: u32) -> f32 {
        self.tree.prefixes[whole as usize].log_probability
    }

    /// The sum of the entropies of all proposals of all states of the block.
    pub(super) fn entropy(&self) -> f64 {
        let undecided = |(index, prefix): (usize, &Prefix)| {
            let entropy = f64::from(entropy(self.tree.log_probabilities(index)));
            if self.is_whole(prefix) { 0.0 } else { f64::from(prefix.count) * entropy }
        };
        self.tree.prefixes.iter().enumerate().map(undecided).sum()
    }

    /// The entropy of one allocation's choices, summed over its agents.
    pub(super) fn entropy_of(&self, whole: u32) -> f32 {
        let parents = self.tree.way_back(whole).map(|prefix| prefix.parent as usize);
        parents.map(|parent| entropy(self.tree.log_probabilities(parent))).sum()
    }

    /// Adds to `gradient` (all parameters) the gradient of
    /// `sum over states of weight * -log f(best) - entropy_weight * sum of all entropies`.
    ///
    /// `best` has an allocation and its weight for each state of the last forward pass.
    pub(super) fn backward(
        &mut self,
        policy: &AllocationPolicy,
        best: &[(u32, f32)],
        entropy_weight: f32,
        gradient: &mut [f32],
    ) {
        let (shape, view) = (policy.shape(), policy.parts());
        self.teams.begin_backward();
        for (whole, weight) in best.iter().filter(|(_, weight)| *weight != 0.0) {
            let way: Vec<Prefix> = self.tree.way_back(*whole).copied().collect();
            way.iter().for_each(|prefix| self.make_likelier(prefix, *weight));
        }
        for index in 0..self.tree.prefixes.len() {
            self.make_livelier(index, entropy_weight);
        }
        let mut gradient: PolicyParts<&mut [f32]> = AllocationPolicy::parts_of(shape, gradient);
        self.trunk.begin_backward(shape, &self.block);
        let (block, trunk) = (&self.block, &mut self.trunk);
        let d_tasks = self.teams.backward(shape, &view, block, trunk, &mut gradient);
        self.trunk.backward(shape, &view, &self.block, d_tasks, &mut gradient);
    }

    /// Adds the slopes of `weight * -log p` of the choice that a prefix ends with.
    fn make_likelier(&mut self, prefix: &Prefix, weight: f32) {
        let (parent, level) = (prefix.parent as usize, prefix.level as usize - 1);
        let chances = self.tree.log_probabilities(parent);
        for ((task, team), chance) in (0..).zip(self.tree.teams(parent)).zip(chances) {
            if *team != NONE {
                let chosen = if task == prefix.task { 1.0 } else { 0.0 };
                self.teams.add_slope(*team, level, weight * (exp(*chance) - chosen));
            }
        }
    }

    /// Adds the slopes of `-weight * entropy` of the choices after a prefix, for all who come by.
    fn make_livelier(&mut self, index: usize, weight: f32) {
        let prefix = self.tree.prefixes[index];
        if self.is_whole(&prefix) {
            return;
        }
        let chances = self.tree.log_probabilities(index);
        let (entropy, weight) = (entropy(chances), weight * prefix.count as f32);
        for (team, chance) in self.tree.teams(index).iter().zip(chances) {
            if *team != NONE {
                let slope = weight * exp(*chance) * (*chance + entropy);
                self.teams.add_slope(*team, prefix.level as usize, slope);
            }
        }
    }

    /// Floating-point operations of all passes up to now.
    pub(super) fn operations(&self) -> u64 {
        self.trunk.operations + self.teams.operations
    }
}

/// Turns logits into log-probabilities; minus infinity stays.
fn log_softmax(logits: &mut [f32]) {
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let possible = logits.iter().filter(|logit| logit.is_finite());
    let sum: f32 = possible.map(|logit| exp(logit - largest)).sum();
    let shift = largest + sum.ln();
    logits.iter_mut().for_each(|logit| *logit -= shift);
}

fn entropy(log_probabilities: &[f32]) -> f32 {
    let possible = log_probabilities.iter().filter(|chance| chance.is_finite());
    -possible.map(|chance| exp(*chance) * chance).sum::<f32>()
}

fn largest(values: &[f32]) -> usize {
    largest_of(values.iter().copied())
}

/// The first of the largest values.
fn largest_of(values: impl Iterator<Item = f32>) -> usize {
    let mut best = (0, f32::NEG_INFINITY);
    for (index, value) in values.enumerate() {
        if value > best.1 {
            best = (index, value);
        }
    }
    best.0
}

/// The choice at a uniform number in 0..1.
fn draw(log_probabilities: &[f32], uniform: f64) -> usize {
    let mut rest = uniform as f32;
    let mut last = 0;
    for (task, chance) in log_probabilities.iter().enumerate().filter(|(_, c)| c.is_finite()) {
        last = task;
        rest -= exp(*chance);
        if rest < 0.0 {
            break;
        }
    }
    last
}
