//! Allocations proposed by the policy, with their probabilities, on a tape.
//!
//! Dissertation section 7.2.2 and the public code's autoregressive pointer policy, rewritten so that every
//! distinct thing is computed once: see [`super::tree`].
//!
//! The vector of a subtask is the sum of what its entities attend to among themselves; an entity alone
//! attends to itself with weight 1, so that its queries and keys need not be computed. An agent that joins adds
//! `W relu([task; agent]) + b` to the vector of its subtask. Both halves of the product stand alone: the agent's is the
//! same for all proposals, the task's for all agents that join this very team.

use std::ops::Range;

use sortie_core::internal::math::exp;
use sortie_envs::random::unit;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Pass, Tape, Var};

use super::networks::{AllocationPolicy, PolicyLayers};
use super::rows::{Shown, States};
use super::tree::{Asked, Block, IMPOSSIBLE, NONE, Prefix, Team, Tree, is_possible};
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

/// What the teams of a block are computed from.
#[derive(Debug)]
struct Vectors {
    /// `[agents, E]`
    agents: Var,
    /// `[agents, 3]`: products of agents and count vectors.
    counts: Var,
    /// `[agents that others follow, E]`: what an agent adds to the vector of its subtask.
    updates: Var,
    /// `[teams, E]`
    teams: Var,
    /// `[products, E]`: what is added to the vectors of these teams, whoever joins.
    products: Option<Var>,
}

impl PolicyLayers {
    /// Embeds the agents, and computes the vectors of the open subtasks.
    fn begin(self, t: &mut Pass<'_>, block: &Block) -> Vectors {
        let width = self.out.shape.input;
        let rows = t.sparse_linear(&block.rows, self.embedding);
        let agents = t.rows(rows, 0..block.agent_count);
        let others = t.rows(rows, block.agent_count..block.rows.len());
        let others = t.relu(others);
        let attended = if block.alone {
            let weight = self.keys_values.weight + width * width;
            t.linear(others, Linear { shape: self.queries.shape, weight, bias: None })
        } else {
            let queries = t.linear(others, self.queries);
            let keys_values = t.linear(others, self.keys_values);
            t.attention(queries, keys_values, &block.same_task, self.heads)
        };
        let sums = t.scatter(attended, &block.entity_open, block.open_count());
        let sums = t.linear(sums, Linear { bias: None, ..self.out });
        // A subtask has the offsets as often as it has entities.
        let offsets = t.parameter(self.out.bias.expect("offsets"), [1, width]);
        let members = t.input(1, &block.members);
        let offsets = t.product(members, offsets);
        let teams = t.add(sums, offsets);

        let followed = t.rows(agents, 0..block.followed);
        let rectified = t.relu(followed);
        let updates = t.linear(rectified, self.update_agent);
        let counts = t.parameter(self.count, [3, width]);
        let counts = t.product_transposed(agents, counts);
        Vectors { agents, counts, updates, teams, products: None }
    }

    /// The logits `[prefixes T, 1]` of the choices that are asked for.
    fn logits(self, t: &mut Pass<'_>, vectors: &Vectors, teams: &[Team], asked: &Asked) -> Var {
        let width = self.out.shape.input;
        let [agents, own] = [(vectors.agents, &asked.agents), (vectors.teams, &asked.teams)]
            .map(|(all, rows)| t.gather(all, rows));
        let products = t.multiply(agents, own);
        let dots = t.sum_columns(products);
        let numbers = asked.teams.iter().map(|team| teams[*team as usize]);
        let numbers: Vec<f32> = numbers.flat_map(|team| [team.others, team.size, 1.0]).collect();
        let (numbers, counts) = (t.input(3, &numbers), t.gather(vectors.counts, &asked.agents));
        let counts = t.multiply(counts, numbers);
        let counts = t.sum_columns(counts);
        let logits = t.add(dots, counts);
        let logits = t.scale(logits, 1.0 / (width as f32).sqrt());
        let impossible = t.input(1, &[IMPOSSIBLE]);
        let all = t.stack(&[logits, impossible]);
        t.gather(all, &asked.places)
    }

    /// Computes the vectors of all teams that arose since the last call.
    fn grow(self, t: &mut Pass<'_>, vectors: &mut Vectors, tree: &Tree) {
        let new = &tree.teams[t.size(vectors.teams)[0]..];
        if new.is_empty() {
            return;
        }
        let known = vectors.products.map_or(0, |products| t.size(products)[0]);
        let products_of = &tree.products_of[known..];
        if !products_of.is_empty() {
            let before = t.gather(vectors.teams, products_of);
            let rectified = t.relu(before);
            let products = t.linear(rectified, self.update_task);
            let all = vectors.products.map_or(products, |older| t.stack(&[older, products]));
            vectors.products = Some(all);
        }
        let products = vectors.products.expect("a product for every team that is joined");
        let product_of = |team: &Team| tree.teams[team.before as usize].product;
        let lists: [Vec<u32>; 3] = [
            new.iter().map(|team| team.before).collect(),
            new.iter().map(product_of).collect(),
            new.iter().map(|team| team.joined).collect(),
        ];
        let sum = t.gather(vectors.teams, &lists[0]);
        let products = t.gather(products, &lists[1]);
        let updates = t.gather(vectors.updates, &lists[2]);
        let sum = t.add(sum, products);
        let sum = t.add(sum, updates);
        vectors.teams = t.stack(&[vectors.teams, sum]);
    }
}

/// The proposals of a block of states, and the pass that computed them.
#[derive(Debug)]
pub(super) struct Proposals<'a> {
    pub(super) t: Pass<'a>,
    pub(super) block: Block,
    pub(super) tree: Tree,
    /// Of every level, the log-probabilities `[prefixes, T]` of its choices.
    chances: Vec<Var>,
    proposals: usize,
}

impl<'a> Proposals<'a> {
    /// Proposes `proposals` allocations for each of a range of states; `columns [T]` are task columns.
    pub(super) fn draw(
        tape: &'a mut Tape,
        policy: &'a AllocationPolicy,
        (states, range): (&States, Range<usize>),
        columns: &[u8],
        (proposals, noise): (usize, Noise<'_>),
    ) -> Self {
        let layers = policy.layers;
        let shown = Shown { shape: policy.shape, states, columns };
        let block = Block::of(shown, range.clone());
        let tree = Tree::begin(&block, proposals);
        let t = tape.begin(&policy.parameters.values);
        let mut own = Self { t, block, tree, chances: Vec::new(), proposals };
        let mut vectors = layers.begin(&mut own.t, &own.block);
        let mut generators: Vec<Generator> = match noise {
            Noise::Seeded { seed, .. } => {
                range.map(|state| generator(seed, Purpose::Proposals, state as u64)).collect()
            }
            Noise::Gumbel(_) | Noise::Given(_) => Vec::new(),
        };
        let mut start = 0;
        let deepest = own.block.levels.iter().copied().max().unwrap_or(0);
        for level in 0..deepest {
            let Self { t, block, tree, chances, .. } = &mut own;
            let prefixes = start..tree.prefixes.len();
            let asked = tree.ask(block, prefixes.clone());
            let logits = layers.logits(t, &vectors, &tree.teams, &asked);
            let logits = t.reshape(logits, block.tasks);
            let choices = t.log_softmax(logits);
            chances.push(choices);
            (0..own.block.len()).for_each(|local| own.choose(local, level, noise, &mut generators));
            layers.grow(&mut own.t, &mut vectors, &own.tree);
            start = prefixes.end;
        }
        own
    }

    /// Lets all proposals of a state choose for their next agent.
    fn choose(
        &mut self,
        local: usize,
        level: usize,
        noise: Noise<'_>,
        generators: &mut [Generator],
    ) {
        let Self { t, block, tree, chances: by_level, proposals } = self;
        let levels = block.levels[local];
        if level >= levels {
            return;
        }
        let agent = usize::from(block.slots[local * block.agents + level]);
        let (agent_row, follows) = (block.agent(local as u32, level as u32), level + 1 < levels);
        let all = t.values(by_level[level]);
        for proposal in 0..*proposals {
            let index = local * *proposals + proposal;
            let row = tree.prefixes[tree.at[index] as usize].row as usize;
            let chances = &all[row * block.tasks..][..block.tasks];
            let own = (block.states.start * *proposals + index) * block.agents + agent;
            let task = match noise {
                Noise::Seeded { greedy_first: true, .. } if proposal == 0 => {
                    largest(chances.iter().copied())
                }
                Noise::Seeded { .. } => choice_at(chances, unit(&mut generators[local])),
                Noise::Gumbel(noise) => {
                    let noise = &noise[own * chances.len()..];
                    largest(chances.iter().zip(noise).map(|(chance, noise)| chance + noise))
                }
                Noise::Given(allocations) => usize::from(allocations[own]),
            };
            tree.choose(index, (task, chances[task]), (agent_row, follows));
        }
    }

    /// Every state of the block with its distinct allocations `[K, A]`.
    pub(super) fn distinct(&self) -> impl Iterator<Item = (usize, Vec<u8>)> {
        self.block.states.clone().enumerate().map(|(local, state)| {
            let mut allocations = Vec::new();
            self.distinct_of(local).for_each(|whole| self.write(whole, &mut allocations));
            (state, allocations)
        })
    }

    /// The distinct allocations of a state of the block.
    pub(super) fn distinct_of(&self, local: usize) -> Range<u32> {
        // Whole prefixes of a state stand behind each other, as they arise together.
        let at = &self.tree.at[local * self.proposals..][..self.proposals];
        let first = at.iter().min().copied().unwrap_or(0);
        first..at.iter().max().map_or(0, |last| last + 1)
    }

    /// The distinct allocation that a proposal of a state is.
    pub(super) fn of_proposal(&self, local: usize, proposal: usize) -> u32 {
        self.tree.at[local * self.proposals + proposal]
    }

    /// Adds an allocation `[A]`; absent agents have no subtask.
    pub(super) fn write(&self, whole: u32, allocations: &mut Vec<u8>) {
        let agents = self.block.agents;
        let start = allocations.len();
        allocations.resize(start + agents, NO_TASK);
        for prefix in self.tree.way_back(whole) {
            let place = prefix.state as usize * agents + prefix.level as usize - 1;
            allocations[start + usize::from(self.block.slots[place])] = prefix.task;
        }
    }

    /// The log-probability `log f(b | s)` of an allocation.
    pub(super) fn log_probability(&self, whole: u32) -> f32 {
        self.tree.prefixes[whole as usize].log_probability
    }

    /// The sum of the entropies of all proposals of all states of the block.
    pub(super) fn entropy(&self) -> f64 {
        let asked = self.tree.prefixes.iter().filter(|prefix| prefix.row != NONE);
        let own = |prefix: &Prefix| {
            f64::from(prefix.count) * f64::from(entropy(self.log_probabilities(prefix)))
        };
        asked.map(own).sum()
    }

    /// The log-probabilities `[T]` of the choices behind a prefix that asked for them.
    pub(super) fn log_probabilities(&self, prefix: &Prefix) -> &[f32] {
        let all = self.t.values(self.chances[prefix.level as usize]);
        &all[prefix.row as usize * self.block.tasks..][..self.block.tasks]
    }

    /// Adds to `gradient` (all parameters) the gradient of
    /// `sum over states of weight * -log f(best) - entropy_weight * sum of all entropies`.
    ///
    /// `best` has an allocation and its weight for each state.
    pub(super) fn descend(
        &mut self,
        best: &[(u32, f32)],
        entropy_weight: f32,
        gradient: &mut [f32],
    ) {
        let Self { t, block, tree, chances, .. } = self;
        let zeros = |level: &Var| vec![0.0; t.values(*level).len()];
        let mut chosen: Vec<Vec<f32>> = chances.iter().map(zeros).collect();
        let mut counts = chosen.clone();
        for (whole, weight) in best {
            for prefix in tree.way_back(*whole) {
                let Prefix { level, row, .. } = tree.prefixes[prefix.parent as usize];
                let place = row as usize * block.tasks + usize::from(prefix.task);
                chosen[level as usize][place] -= weight;
            }
        }
        for Prefix { level, row, count, .. } in tree.prefixes.iter() {
            if let Some(own) = counts.get_mut(*level as usize)
                && let Some(own) = own.get_mut(*row as usize * block.tasks..)
            {
                own[..block.tasks].fill(entropy_weight * *count as f32);
            }
        }
        let mut terms = Vec::new();
        for ((chances, chosen), counts) in chances.iter().zip(&chosen).zip(&counts) {
            terms.push(t.weighted_sum(*chances, chosen));
            let probabilities = t.exp(*chances);
            let lost = t.multiply(probabilities, *chances);
            terms.push(t.weighted_sum(lost, counts));
        }
        if !terms.is_empty() {
            let terms = t.concat(&terms);
            let loss = t.sum_columns(terms);
            t.backward(loss, gradient);
        }
    }
}

pub(super) fn entropy(log_probabilities: &[f32]) -> f32 {
    let possible = log_probabilities.iter().filter(|chance| is_possible(**chance));
    -possible.map(|chance| exp(*chance) * chance).sum::<f32>()
}

/// The first of the largest values.
fn largest(values: impl Iterator<Item = f32>) -> usize {
    let mut best = (0, f32::NEG_INFINITY);
    for (index, value) in values.enumerate() {
        if value > best.1 {
            best = (index, value);
        }
    }
    best.0
}

/// The choice at a uniform number in 0..1.
fn choice_at(log_probabilities: &[f32], uniform: f64) -> usize {
    let mut rest = uniform as f32;
    let mut last = 0;
    let possible = log_probabilities.iter().enumerate().filter(|(_, chance)| is_possible(**chance));
    for (task, chance) in possible {
        last = task;
        rest -= exp(*chance);
        if rest < 0.0 {
            break;
        }
    }
    last
}
