//! What networks look at: the entities of any number of independent states, and their partitions, for imagination
//! (dissertation section 5.4).
//!
//! A partition says for each agent which entities are in its part. The imagined utilities see either
//! what lies within or what lies across.

use std::collections::HashMap;

use sortie_envs::random::{chance, unit};
use sortie_envs::{ActionSet, EntitySet, Observation, Random, SparseRows, members};
use sortie_learn::words;

use super::looking::View;
use super::memory::{Moment, Timeline};
use super::split_attention::SplitLists;

words! {
    /// Where the partitions of imagined utilities come from.
    Partitions {
        /// Nothing is imagined (A-QMIX, VDN).
        None = "none",
        /// Drawn for every use of a state (REFIL): `p` uniform, then each entity with probability `p`.
        Drawn = "drawn",
        /// Who truly belongs together, as the environment knows (fixed oracle).
        Companions = "companions",
        /// Who truly belongs together and shares the drawn part (randomised oracle).
        DrawnCompanions = "drawn-companions",
    }
}

impl Partitions {
    /// Whether anything is imagined.
    pub fn imagines(self) -> bool {
        self != Self::None
    }

    /// Whether it is about who truly belongs together.
    pub fn needs_companions(self) -> bool {
        matches!(self, Self::Companions | Self::DrawnCompanions)
    }

    /// Draws one part of so many entities, as bits, where the partition is one that is drawn.
    pub fn draw(self, entities: usize, random: &mut Random) -> EntitySet {
        if matches!(self, Self::None | Self::Companions) {
            return 0;
        }
        let probability = unit(random);
        (0..entities)
            .fold(0, |part, entity| part | EntitySet::from(chance(random, probability)) << entity)
    }

    /// The entities in the part of one agent, given the drawn part and the agent's companions.
    pub fn within(self, part: EntitySet, companions: EntitySet, agent: usize) -> EntitySet {
        let drawn = if part >> agent & 1 == 1 { part } else { !part };
        match self {
            Self::None => EntitySet::MAX,
            Self::Drawn => drawn,
            Self::Companions => companions,
            Self::DrawnCompanions => drawn & companions,
        }
    }
}

/// States one behind the other. Query i belongs to row i: the rows of all agents that exist come first.
///
/// Where rows are [shared](Self::sharing), every different row stands there once: what networks make of
/// each entity alone is made once, however often it is seen.
#[derive(Clone, Debug, Default)]
pub struct Scenes {
    rows: SparseRows,
    others: SparseRows,
    shared: Option<Shared>,
    seen: SplitLists,
    known: SplitLists,
    timeline: Timeline,
    sizes: Vec<usize>,
    available: Vec<ActionSet>,
    sets: Vec<Sets>,
    queries: Vec<Query>,
    /// Whether some agent does not see everything that exists in its state.
    hides: bool,
}

/// The different rows among many.
#[derive(Clone, Debug, Default)]
struct Shared {
    rows: SparseRows,
    /// For each of the many the one that it equals.
    places: Vec<u32>,
    known: HashMap<Vec<(usize, u32)>, u32>,
    row: Vec<(usize, u32)>,
}

impl Shared {
    fn fill(&mut self, all: &SparseRows) {
        let Self { rows, places, known, row } = self;
        rows.clear();
        places.clear();
        known.clear();
        for index in 0..all.len() {
            row.clear();
            row.extend(all.row(index).map(|(column, value)| (column, value.to_bits())));
            let place = known.get(&**row).copied().unwrap_or_else(|| {
                let place = rows.len() as u32;
                rows.push_row(all, index);
                rows.end_row();
                known.insert(row.clone(), place);
                place
            });
            places.push(place);
        }
    }
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
    /// No states yet, of which equal rows are to be one.
    pub fn sharing() -> Self {
        Self { shared: Some(Shared::default()), ..Self::default() }
    }

    /// Forgets all states, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.others.clear();
        self.timeline.clear();
        self.sizes.clear();
        self.available.clear();
        self.sets.clear();
        self.queries.clear();
        self.hides = false;
    }

    /// Adds a state of which all rows have been observed, the first of an episode of its own; `within` gives
    /// the entities in the part of an agent.
    pub fn push(&mut self, seen: &Observation, within: impl Fn(usize) -> EntitySet) {
        let episode = self.sizes.len();
        self.push_at(Moment { episode, ..Moment::default() }, seen, within);
    }

    /// As [`push`](Self::push), of any moment of an episode.
    pub fn push_at(
        &mut self,
        moment: Moment,
        seen: &Observation,
        within: impl Fn(usize) -> EntitySet,
    ) {
        let slots = (1 << seen.observable.len()) - 1;
        let (agents, others) = (seen.present & slots, seen.present & !slots);
        let (first_agent, first_other) = (self.rows.len(), self.others.len());
        self.sets.push(Sets { agents, others, first_agent, first_other });
        self.sizes.push(agents.count_ones() as usize);
        self.timeline.push(moment, seen.observable.len(), members(agents));
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
        if let Some(shared) = &mut self.shared {
            shared.fill(&self.rows);
        }
        self.seen.clear();
        self.known.clear();
        let mut queries = self.queries.iter();
        for sets in &self.sets {
            let present = sets.agents | sets.others;
            let row = |entity: usize| {
                let before = (1u128 << entity) - 1;
                let row = if sets.agents >> entity & 1 == 1 {
                    sets.first_agent + (sets.agents & before).count_ones() as usize
                } else {
                    agents + sets.first_other + (sets.others & before).count_ones() as usize
                };
                self.shared.as_ref().map_or(row, |shared| shared.places[row] as usize)
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

    pub(super) fn seen(&self) -> View<'_> {
        self.view(&self.seen)
    }

    /// For each agent everything that exists in its state.
    pub(super) fn known(&self) -> View<'_> {
        self.view(if self.hides { &self.known } else { &self.seen })
    }

    /// Where the agents stand in time.
    pub(super) fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    fn view<'a>(&'a self, lists: &'a SplitLists) -> View<'a> {
        match &self.shared {
            Some(Shared { rows, places, .. }) => {
                View { rows, own: &places[..self.agents()], lists }
            }
            None => View { rows: &self.rows, own: &[], lists },
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.sizes.is_empty()
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
