//! The team-value allocator: learns what a team at a subtask is worth, and searches the best teams.
//!
//! An allocation b is worth `Q(s, b) = sum over open subtasks t of f(s, t, team of t in b)`. f is one
//! attention network of the agents' kind with a single output: the row of the subtask's thing is the query, and
//! the keys are that thing itself, every agent (in the team or not, and how far away) and the things of the other
//! open subtasks. A team without agents is a legal input. `sortie_core::allocate` finds the best
//! allocation by the values of all teams.
//!
//! f is learned by SARSA, one target per subtask, from the subtask's own rewards. Compared
//! with the dissertation (section 7.4): a sum of one value per subtask instead of a critic of the whole
//! allocation, search instead of a proposal network, task rewards instead of the team's.

mod input;
mod loss;

use sortie_core::allocate::{EXACT_AGENTS, TeamValue, Teams, ascent, exact};
use sortie_envs::{Environment, Observation, UNASSIGNED, deployed_tasks, members};
use sortie_learn::LearnError;
use sortie_learn::subtasks::{Allocate, ToAllocate};
use sortie_nn::tape::Tape;

use crate::alma::agents::{UtilityInput, UtilityLayers, UtilityView};

pub use input::{TeamColumns, TeamQuery, TeamValueInput};
pub use loss::{Allocator, DrawnSegment, Segments, TeamLesson, TeamValues};

/// Sweeps of the coordinate ascent; few are needed until no agent moves.
const SWEEPS: usize = 8;

/// What search takes to ask a network.
#[derive(Debug, Default)]
struct Values {
    tape: Tape,
    input: TeamValueInput,
    values: Vec<f32>,
    operations: u64,
}

impl Values {
    /// What a network says to the questions that `write` writes, one number each.
    fn of(
        &mut self,
        network: UtilityView<'_>,
        write: impl FnOnce(&mut TeamValueInput) -> &UtilityInput,
    ) -> &[f32] {
        let layers = UtilityLayers::of(network.shape);
        let mut pass = self.tape.begin_forward(network.parameters);
        let values = layers.utilities(&mut pass, write(&mut self.input));
        self.values.clear();
        self.values.extend_from_slice(pass.values(values));
        self.operations += pass.operations(false);
        &self.values
    }
}

/// Space to search allocations.
#[derive(Debug)]
pub struct TeamSearch {
    team_max: usize,
    values: Values,
    seen: Observation,
    arena: Vec<exact::Cell>,
}

impl TeamSearch {
    /// Empty space; no subtask gets more than `team_max` agents.
    pub fn new(team_max: usize) -> Self {
        let (values, seen) = (Values::default(), Observation::default());
        Self { team_max, values, seen, arena: Vec::new() }
    }

    /// Floating-point operations up to now.
    pub fn operations(&self) -> u64 {
        self.values.operations
    }

    /// Writes the best subtask of every agent; further entries are [`UNASSIGNED`].
    ///
    /// Exact for up to [`EXACT_AGENTS`] agents; for more, coordinate ascent from what the environment's usual rule allocates.
    pub fn allocate(
        &mut self,
        network: UtilityView<'_>,
        to: ToAllocate<'_>,
    ) -> Result<(), LearnError> {
        let ToAllocate { environment, state, random, allocation } = to;
        environment.observe(state, 0, 0, &mut self.seen);
        let acting: Vec<usize> = members(self.seen.acting().into()).collect();
        let (agents, open_tasks) = (acting.len(), deployed_tasks(self.seen.open_tasks));
        let teams = Teams { agents, open_tasks, team_max: self.team_max };
        let mut own = vec![UNASSIGNED; agents];
        let found = if agents <= EXACT_AGENTS {
            let values = self.values.of(network, |input| input.all_teams(environment, state));
            self.arena.resize(values.len(), exact::Cell::default());
            exact::search(teams, values, &mut self.arena, &mut own).map(drop)
        } else {
            environment.allocate(0, state, random, allocation);
            own.iter_mut().zip(&acting).for_each(|(own, agent)| *own = allocation[*agent]);
            let (acting, values) = (&acting, &mut self.values);
            let mut values = NetworkValue { network, environment, state, acting, values };
            ascent::search(teams, &mut values, SWEEPS, &mut own).map(drop)
        };
        allocation.fill(UNASSIGNED);
        acting.iter().zip(own).for_each(|(agent, own)| allocation[*agent] = own);
        Ok(found?)
    }
}

/// The values of single teams, as the coordinate ascent asks for them.
struct NetworkValue<'a> {
    network: UtilityView<'a>,
    environment: &'a dyn Environment,
    state: &'a [u8],
    /// The agents that the bits of a team stand for.
    acting: &'a [usize],
    values: &'a mut Values,
}

impl TeamValue for NetworkValue<'_> {
    fn value(&mut self, task: usize, team: u64) -> f32 {
        let mut value = [0.0];
        self.values(&[(task, team)], &mut value);
        value[0]
    }

    fn values(&mut self, questions: &[(usize, u64)], values: &mut [f32]) {
        let Self { network, environment, state, acting, values: asked } = self;
        let query = |(task, team): &(usize, u64)| {
            let team = members((*team).into()).fold(0, |team, place| team | 1 << acting[place]);
            TeamQuery { state, task: *task, team, turn: 0 }
        };
        let queries = questions.iter().map(query);
        values.copy_from_slice(asked.of(*network, |input| input.queries(*environment, queries)));
    }
}

/// A team-value network as allocator.
#[derive(Debug)]
pub struct TeamValueAllocator<'a> {
    network: UtilityView<'a>,
    search: TeamSearch,
}

impl<'a> TeamValueAllocator<'a> {
    /// Allocates by a network; no subtask gets more than `team_max` agents.
    pub fn new(network: UtilityView<'a>, team_max: usize) -> Self {
        Self { network, search: TeamSearch::new(team_max) }
    }
}

impl Allocate for TeamValueAllocator<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<(), LearnError> {
        self.search.allocate(self.network, to)
    }

    fn values(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        task: usize,
        teams: &[u64],
    ) -> Vec<f32> {
        let queries = teams.iter().map(|&team| TeamQuery { state, task, team, turn: 0 });
        let values = &mut self.search.values;
        values.of(self.network, |input| input.queries(environment, queries)).to_vec()
    }
}

#[cfg(test)]
mod tests;
