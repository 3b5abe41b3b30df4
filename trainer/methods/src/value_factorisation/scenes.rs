//! What networks look at: the entities of any number of independent states.

use sortie_envs::{ActionSet, EntitySet, Observation, SparseRows, members};

use super::split_attention::SplitLists;

/// States one behind the other. Query i belongs to row i: the rows of all agents that exist come first.
#[derive(Clone, Debug, Default)]
pub struct Scenes {
    rows: SparseRows,
    others: SparseRows,
    seen: SplitLists,
    known: SplitLists,
    sizes: Vec<usize>,
    available: Vec<ActionSet>,
    sets: Vec<Sets>,
    queries: Vec<Query>,
    /// Whether some agent does not see everything that exists in its state.
    hides: bool,
}

/// Where the entities of a state stand.
#[derive(Clone, Copy, Debug)]
struct Sets {
    agents: EntitySet,
    others: EntitySet,
    first_agent: usize,
    first_other: usize,
}

/// What one agent observes and who is in its part.
#[derive(Clone, Copy, Debug)]
struct Query {
    observable: EntitySet,
    within: EntitySet,
}

impl Scenes {
    /// Forgets all states, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.others.clear();
        self.sizes.clear();
        self.available.clear();
        self.sets.clear();
        self.queries.clear();
        self.hides = false;
    }

    /// Adds a state of which all rows have been observed; `within` gives the entities in the part of an
    /// agent.
    pub fn push(&mut self, seen: &Observation, within: impl Fn(usize) -> EntitySet) {
        let slots = (1 << seen.observable.len()) - 1;
        let (agents, others) = (seen.present & slots, seen.present & !slots);
        let (first_agent, first_other) = (self.rows.len(), self.others.len());
        self.sets.push(Sets { agents, others, first_agent, first_other });
        self.sizes.push(agents.count_ones() as usize);
        for agent in members(agents) {
            self.rows.push_row(&seen.rows, seen.row_of(agent));
            self.rows.end_row();
            let observable = seen.observable[agent] & seen.present;
            self.hides |= observable != seen.present;
            self.available.push(seen.available[agent]);
            self.queries.push(Query { observable, within: within(agent) });
        }
        for other in members(others) {
            self.others.push_row(&seen.rows, seen.row_of(other));
            self.others.end_row();
        }
    }

    /// Ends the pushing: lists who sees what.
    pub fn finish(&mut self) {
        let agents = self.rows.len();
        self.rows.append(&self.others);
        self.seen.clear();
        self.known.clear();
        let mut queries = self.queries.iter();
        for sets in &self.sets {
            let present = sets.agents | sets.others;
            let row = |entity: usize| {
                let before = (1u128 << entity) - 1;
                if sets.agents >> entity & 1 == 1 {
                    sets.first_agent + (sets.agents & before).count_ones() as usize
                } else {
                    agents + sets.first_other + (sets.others & before).count_ones() as usize
                }
            };
            for query in queries.by_ref().take(sets.agents.count_ones() as usize) {
                let split = |seen: EntitySet| (seen & query.within, seen & !query.within);
                let (within, across) = split(query.observable);
                self.seen.push(members(within).map(row), members(across).map(row));
                if self.hides {
                    let (within, across) = split(present);
                    self.known.push(members(within).map(row), members(across).map(row));
                }
            }
        }
    }

    /// Features of every entity, the agents' first.
    pub(super) fn rows(&self) -> &SparseRows {
        &self.rows
    }

    /// For each agent the rows that it sees.
    pub(super) fn seen(&self) -> &SplitLists {
        &self.seen
    }

    /// For each agent the rows of everything that exists in its state.
    pub(super) fn known(&self) -> &SplitLists {
        if self.hides { &self.known } else { &self.seen }
    }

    /// Number of agents of every state.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// The actions that each agent may take.
    pub fn available(&self) -> &[ActionSet] {
        &self.available
    }

    /// Agents of all states.
    pub fn agents(&self) -> usize {
        self.seen.queries()
    }
}
