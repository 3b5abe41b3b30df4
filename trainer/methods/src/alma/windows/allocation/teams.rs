//! The vectors of subtasks with the agents that have joined them.
//!
//! An agent that joins adds `W relu([task; agent]) + b` to the vector of its subtask. Both halves of the
//! product stand alone: the agent's is the same for all proposals, the task's for all agents that join
//! this very team. So a team is computed once, whatever else the proposals around it say.
//!
//! Allocations are proposed agent by agent: proposals that begin alike share what follows from it, as a tree.

use std::ops::Range;

use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::vectors::add_scaled;
use sortie_nn::layers::{linear, relu};

use super::AllocationShape;
use super::gathers::{
    Slope, Sum, add_rectified, add_three, dot_pairs, dot_pairs_backward, gather, scatter_add,
};
use super::networks::{COUNT_SCALE, PolicyParts};
use super::trunk::{Block, NONE, Trunk, times_counts};
use crate::sized;

/// One team at one subtask of one state.
#[derive(Clone, Copy, Debug)]
struct Team {
    /// The team before the last agent joined, or [`NONE`].
    before: u32,
    /// The last agent's row.
    joined: u32,
    /// Where the product stands that all who join need, or [`NONE`].
    product: u32,
    /// Agents, times [`COUNT_SCALE`].
    size: f32,
    /// Other entities of the subtask, times [`COUNT_SCALE`].
    others: f32,
}

/// Where the teams and products of one level end.
#[derive(Clone, Copy, Debug, Default)]
struct Ends {
    teams: usize,
    products: usize,
}

/// All teams of a block of states, by the level at which they arose; buffers of one worker.
#[derive(Clone, Debug, Default)]
pub(super) struct Teams {
    agents: usize,
    teams: Vec<Team>,
    /// `[teams, A]`: the team after the agent of each level has joined, or [`NONE`].
    after: Vec<u32>,
    /// `[teams, A]`: the logit of each level's agent, NaN where nobody asked.
    logits: Vec<f32>,
    d_logits: Vec<f32>,
    /// `[agents, 3]`: products of agents and count vectors.
    counts: Vec<f32>,
    d_counts: Vec<f32>,
    /// `[teams, E]`
    vectors: Vec<f32>,
    /// The team that each product is about.
    products_of: Vec<u32>,
    /// `[products, E]`: vectors of teams, rectified.
    rectified: Vec<f32>,
    /// `[products, E]`
    products: Vec<f32>,
    ends: Vec<Ends>,
    asked: Vec<(u32, u32)>,
    asked_places: Vec<u32>,
    answers: Vec<f32>,
    slopes: Vec<Slope>,
    sums: Vec<Sum>,
    d_vectors: Vec<f32>,
    d_products: Vec<f32>,
    d_rectified: Vec<f32>,
    /// Floating-point operations of products and logits.
    pub(super) operations: u64,
}

impl Teams {
    /// Begins with the subtasks of a block, to which nobody belongs yet; returns the place `[open, E]` of
    /// their vectors.
    pub(super) fn begin(&mut self, shape: AllocationShape, block: &Block) -> &mut [f32] {
        self.agents = block.agents;
        self.teams.clear();
        self.after.clear();
        self.logits.clear();
        self.products_of.clear();
        self.ends.clear();
        for others in &block.others {
            let (before, joined, product) = (NONE, NONE, NONE);
            self.push(Team { before, joined, product, size: 0.0, others: *others });
        }
        self.ends.push(Ends { teams: self.teams.len(), products: 0 });
        sized(&mut self.vectors, block.open_count() * shape.width)
    }

    /// Computes the products of agents and count vectors, once the block's trunk is there.
    pub(super) fn count_agents(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        agents: &[f32],
    ) {
        let counts = sized(&mut self.counts, agents.len() / shape.width * 3);
        times_counts(shape.width, agents, view.count, counts);
    }

    fn push(&mut self, team: Team) -> u32 {
        self.teams.push(team);
        let length = self.teams.len() * self.agents;
        self.after.resize(length, NONE);
        self.logits.resize(length, f32::NAN);
        (self.teams.len() - 1) as u32
    }

    /// Asks for the logit of a level's agent, who is a row, at a team.
    pub(super) fn ask(&mut self, team: u32, level: usize, row: u32) {
        let place = team as usize * self.agents + level;
        if self.logits[place].is_nan() {
            self.logits[place] = 0.0;
            self.asked.push((row, team));
            self.asked_places.push(place as u32);
        }
    }

    /// Computes all logits that were asked for.
    pub(super) fn answer(&mut self, shape: AllocationShape, agents: &[f32]) {
        let answers = sized(&mut self.answers, self.asked.len());
        dot_pairs(shape.width, agents, &self.vectors, &self.asked, answers);
        let scale = logit_scale(shape);
        for (((row, team), place), dot) in
            self.asked.iter().zip(&self.asked_places).zip(answers.iter())
        {
            let counts = &self.counts[*row as usize * 3..][..3];
            let team = self.teams[*team as usize];
            let logit = dot + team.others * counts[0] + team.size * counts[1] + counts[2];
            self.logits[*place as usize] = logit * scale;
        }
        self.operations += (2 * self.asked.len() * shape.width) as u64;
        self.asked.clear();
        self.asked_places.clear();
    }

    /// The logit of a level's agent at a team, once it was answered.
    pub(super) fn logit(&self, team: u32, level: usize) -> f32 {
        self.logits[team as usize * self.agents + level]
    }

    /// The team after a level's agent, who is a row, has joined; its vector comes with
    /// [`grow`](Self::grow).
    pub(super) fn join(&mut self, team: u32, level: usize, row: u32) -> u32 {
        let place = team as usize * self.agents + level;
        if self.after[place] == NONE {
            let before = &mut self.teams[team as usize];
            if before.product == NONE {
                before.product = self.products_of.len() as u32;
                self.products_of.push(team);
            }
            let Team { size, others, .. } = *before;
            let size = size + COUNT_SCALE;
            self.after[place] =
                self.push(Team { before: team, joined: row, product: NONE, size, others });
        }
        self.after[place]
    }

    /// Computes the vectors of all teams that arose since the last call.
    pub(super) fn grow(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        updates: &[f32],
    ) {
        let width = shape.width;
        let done = self.ends.last().copied().unwrap_or_default();
        let new = Ends { teams: self.teams.len(), products: self.products_of.len() };
        self.ends.push(new);
        sized(&mut self.vectors, new.teams * width);
        sized(&mut self.rectified, new.products * width);
        sized(&mut self.products, new.products * width);
        let span = done.products * width..new.products * width;
        let rectified = &mut self.rectified[span.clone()];
        let teams = &self.products_of[done.products..];
        gather(width, &self.vectors, teams, rectified);
        relu::forward(rectified);
        let products = &mut self.products[span];
        linear::forward_without_bias(shape.square(), rectified, view.update_task, products);
        self.sums.clear();
        for (index, team) in (0..).zip(&self.teams).skip(done.teams) {
            let product = self.teams[team.before as usize].product;
            self.sums.push((index, team.before, product, team.joined));
        }
        add_three(width, &self.sums, &self.products, updates, &mut self.vectors);
        self.operations += (2 * (new.products - done.products) * width * width) as u64;
    }

    /// Makes room for the slopes of all logits, and zeroes it.
    pub(super) fn begin_backward(&mut self) {
        self.d_logits.clear();
        self.d_logits.resize(self.logits.len(), 0.0);
    }

    /// Adds to the slope of a logit.
    pub(super) fn add_slope(&mut self, team: u32, level: usize, slope: f32) {
        self.d_logits[team as usize * self.agents + level] += slope;
    }

    /// Goes back from the slopes of all logits to the gradients of the weights, of agents and updates in
    /// `trunk`, and of the subtasks' vectors, which it returns.
    pub(super) fn backward(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        block: &Block,
        trunk: &mut Trunk,
        gradient: &mut PolicyParts<&mut [f32]>,
    ) -> &[f32] {
        let width = shape.width;
        sized(&mut self.d_vectors, self.teams.len() * width).fill(0.0);
        self.list_slopes(shape, block);
        let (agents, d_agents) = trunk.agents_and_gradient(shape, block);
        let sides = (&mut *d_agents, &mut self.d_vectors[..]);
        dot_pairs_backward(width, agents, &self.vectors, &self.slopes, sides);
        self.operations += (4 * self.slopes.len() * width) as u64;
        for (row, slopes) in self.d_counts.chunks_exact(3).enumerate() {
            let span = row * width..(row + 1) * width;
            for (part, slope) in slopes.iter().enumerate() {
                let count = part * width..(part + 1) * width;
                add_scaled(&mut d_agents[span.clone()], *slope, &view.count[count.clone()]);
                add_scaled(&mut gradient.count[count], *slope, &agents[span.clone()]);
            }
        }
        let d_products = sized(&mut self.d_products, self.products_of.len() * width);
        d_products.fill(0.0);
        for level in (1..self.ends.len()).rev() {
            self.leave(shape, view, level, &mut trunk.d_updates);
        }
        let length = self.products_of.len() * width;
        let (rectified, d_products) = (&self.rectified[..length], &self.d_products[..length]);
        linear::backward_weight(shape.square(), rectified, d_products, gradient.update_task);
        self.operations += (4 * length * width) as u64;
        &self.d_vectors[..block.open_count() * width]
    }

    /// Turns slopes of logits into slopes of dot products and of counts.
    fn list_slopes(&mut self, shape: AllocationShape, block: &Block) {
        let scale = logit_scale(shape);
        self.slopes.clear();
        self.d_counts.clear();
        self.d_counts.resize(block.agent_count * 3, 0.0);
        // A team belongs to the state of its subtask, whose agents stand at its levels.
        let mut state_of = vec![0_u32; self.teams.len()];
        for (place, number) in block.open.iter().enumerate() {
            if *number != NONE {
                state_of[*number as usize] = (place / block.tasks) as u32;
            }
        }
        for (index, team) in self.teams.iter().enumerate() {
            if team.before != NONE {
                state_of[index] = state_of[team.before as usize];
            }
            let slopes = &self.d_logits[index * self.agents..][..self.agents];
            let rows = &block.agent_rows[state_of[index] as usize * self.agents..];
            for (slope, row) in slopes.iter().zip(rows).filter(|(slope, _)| **slope != 0.0) {
                let slope = slope * scale;
                self.slopes.push((*row, index as u32, slope));
                let counts = &mut self.d_counts[*row as usize * 3..][..3];
                counts[0] += slope * team.others;
                counts[1] += slope * team.size;
                counts[2] += slope;
            }
        }
    }

    /// Goes back through the teams that arose at a level, whose own gradients are complete.
    fn leave(
        &mut self,
        shape: AllocationShape,
        view: &PolicyParts<&[f32]>,
        level: usize,
        d_updates: &mut [f32],
    ) {
        let width = shape.width;
        let (start, end) = (self.ends[level - 1], self.ends[level]);
        let teams: Range<usize> = start.teams..end.teams;
        let products: Range<usize> = start.products..end.products;
        let (mut of_product, mut of_update) = (Vec::new(), Vec::new());
        for team in &self.teams[teams.clone()] {
            of_product.push(self.teams[team.before as usize].product);
            of_update.push(team.joined);
        }
        let d_teams = &self.d_vectors[teams.start * width..teams.end * width];
        scatter_add(width, d_teams, &of_product, &mut self.d_products);
        scatter_add(width, d_teams, &of_update, d_updates);

        // A team passes its gradient to the one before it: as it is, and through the product.
        let parents: Vec<u32> = self.teams[teams.clone()].iter().map(|team| team.before).collect();
        let (older, newer) = self.d_vectors.split_at_mut(teams.start * width);
        scatter_add(width, &newer[..teams.len() * width], &parents, older);

        let span = products.start * width..products.end * width;
        let d_rectified = sized(&mut self.d_rectified, span.len());
        let d_products = &self.d_products[span.clone()];
        linear::backward_input(
            shape.square(),
            d_products,
            view.update_task,
            Store::Replace,
            d_rectified,
        );
        let rectified = self.rectified[span].chunks_exact(width);
        for ((team, rectified), d) in
            self.products_of[products].iter().zip(rectified).zip(d_rectified.chunks_exact(width))
        {
            let at = *team as usize * width;
            add_rectified(rectified, d, &mut self.d_vectors[at..][..width]);
        }
    }
}

fn logit_scale(shape: AllocationShape) -> f32 {
    1.0 / (shape.width as f32).sqrt()
}

/// The first agents of a state, allocated. All proposals that begin so share it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prefix {
    /// The state, counted from the block's first.
    pub(super) state: u32,
    /// The prefix without the last agent, or [`NONE`].
    pub(super) parent: u32,
    pub(super) level: u32,
    pub(super) task: u8,
    pub(super) count: u32,
    /// Sum of the log-probabilities of the choices.
    pub(super) log_probability: f32,
}

/// The prefixes of all proposals of a block of states.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    tasks: usize,
    pub(super) prefixes: Vec<Prefix>,
    /// `[prefixes, T]`: the team at each subtask.
    teams: Vec<u32>,
    /// `[prefixes, T]`: log-probabilities of the next agent's choices; minus infinity where impossible.
    log_probabilities: Vec<f32>,
    /// `[prefixes, T]`: the longer prefix after each choice, or [`NONE`].
    longer: Vec<u32>,
    /// `[states, P]`: how far each proposal has come.
    pub(super) at: Vec<u32>,
}

impl Tree {
    /// Begins the proposals of some states, whose subtasks have the teams `roots [states, T]`.
    pub(super) fn begin(&mut self, proposals: usize, tasks: usize, roots: &[u32]) {
        self.tasks = tasks;
        self.prefixes.clear();
        self.teams.clear();
        self.log_probabilities.clear();
        self.longer.clear();
        self.at.clear();
        for (state, roots) in (0..).zip(roots.chunks_exact(tasks)) {
            let count = proposals as u32;
            let root =
                Prefix { state, parent: NONE, level: 0, task: 0, count, log_probability: 0.0 };
            let index = self.push(root, |teams| teams.extend_from_slice(roots));
            self.at.extend((0..proposals).map(|_| index));
        }
    }

    fn push(&mut self, prefix: Prefix, extend_teams: impl FnOnce(&mut Vec<u32>)) -> u32 {
        let index = self.prefixes.len() as u32;
        self.prefixes.push(prefix);
        extend_teams(&mut self.teams);
        let length = self.prefixes.len() * self.tasks;
        self.log_probabilities.resize(length, f32::NEG_INFINITY);
        self.longer.resize(length, NONE);
        index
    }

    /// The teams `[T]` of a prefix.
    pub(super) fn teams(&self, prefix: usize) -> &[u32] {
        &self.teams[prefix * self.tasks..][..self.tasks]
    }

    pub(super) fn log_probabilities(&self, prefix: usize) -> &[f32] {
        &self.log_probabilities[prefix * self.tasks..][..self.tasks]
    }

    pub(super) fn log_probabilities_mut(&mut self, prefix: usize) -> &mut [f32] {
        &mut self.log_probabilities[prefix * self.tasks..][..self.tasks]
    }

    /// Leads a proposal on; `team` is asked for the team after the choice where nobody chose it before.
    pub(super) fn choose(&mut self, proposal: usize, task: usize, team: impl FnOnce(u32) -> u32) {
        let from = self.at[proposal] as usize;
        let place = from * self.tasks + task;
        if self.longer[place] == NONE {
            let Prefix { state, level, log_probability, .. } = self.prefixes[from];
            let longer = Prefix {
                state,
                parent: from as u32,
                level: level + 1,
                task: task as u8,
                count: 0,
                log_probability: log_probability + self.log_probabilities[place],
            };
            let tasks = self.tasks;
            self.longer[place] = self.push(longer, |teams| {
                teams.extend_from_within(from * tasks..(from + 1) * tasks);
                let last = teams.len() - tasks + task;
                teams[last] = team(teams[last]);
            });
        }
        let next = self.longer[place];
        self.prefixes[next as usize].count += 1;
        self.at[proposal] = next;
    }

    /// A prefix and all shorter ones down to one agent.
    pub(super) fn way_back(&self, prefix: u32) -> impl Iterator<Item = &Prefix> {
        let at = |index: u32| self.prefixes.get(index as usize);
        std::iter::successors(at(prefix), move |prefix| at(prefix.parent))
            .take_while(|prefix| prefix.level > 0)
    }
}
