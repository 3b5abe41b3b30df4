//! What networks attend to: the entities of any number of independent states, with who sees what, and for imagination in
//! which part of a partition.

use std::collections::HashMap;
use std::ops::Range;

use sortie_envs::{ActionSet, EntitySet, Observation, SparseRows, members};
use sortie_nn::layers::VisibleLists;

use super::BLOCKS;
use super::aims::{AimView, Aims};

/// When a state was, in which of the episodes that go through time side by side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moment {
    /// Steps since the episode began.
    pub step: usize,
    /// Number of the episode.
    pub episode: usize,
}

/// What is attended to, and by whom.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Features of entities.
    pub rows: &'a SparseRows,
    /// The row of every query, where rows are shared; else query i belongs to row i.
    pub own: &'a [u32],
    /// For each query the rows that it sees, those within its part first.
    pub lists: &'a VisibleLists,
    /// Whether the parts are to be attended to as well.
    pub imagines: bool,
}

/// Teams, whose agents stand one behind the other.
#[derive(Clone, Copy, Debug)]
pub struct Teams<'a> {
    /// What each agent knows of its state.
    pub known: View<'a>,
    /// The team of every agent by its number, of all agents twice where something is imagined.
    pub numbers: &'a [u32],
    /// `[teams]`: agents of each.
    pub sizes: &'a [f32],
}

impl View<'_> {
    /// Number of queries.
    pub fn queries(self) -> usize {
        self.lists.queries()
    }

    /// The same, of which the parts do not matter.
    pub fn whole(self) -> Self {
        Self { imagines: false, ..self }
    }
}

/// States one behind the other. Query i belongs to row i: the rows of all agents that act come first. Who is
/// [absent](Observation::absent) is a thing among others: attended to, but of no utility.
///
/// Where rows are [shared](Self::share_rows), every different row stands there once: what networks make of
/// each entity alone is made once, however often it is seen.
#[derive(Clone, Debug, Default)]
pub struct EntityBatch {
    rows: SparseRows,
    others: SparseRows,
    shared: Option<Shared>,
    seen: VisibleLists,
    known: VisibleLists,
    states: Vec<Sets>,
    queries: Vec<Query>,
    /// Whether some agent does not see everything that exists in its state.
    hides: bool,
    imagines: bool,
    sizes: Vec<usize>,
    team_sizes: Vec<f32>,
    teams: Vec<u32>,
    available: Vec<ActionSet>,
    timeline: Timeline,
    /// What actions aim at, block by block.
    aims: Aims,
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

/// Where the rows of agents stand in time and among episodes.
#[derive(Clone, Debug, Default)]
struct Timeline {
    steps: usize,
    episodes: usize,
    /// Agents of an episode, those too that do not act.
    agents: usize,
    /// Step and slot of each row.
    rows: Vec<(usize, usize)>,
    /// Of one block, and of three: where rows stand among `[steps, blocks, slots]`, and who is there to remember.
    grids: [(Vec<u32>, Vec<bool>); 2],
}

impl EntityBatch {
    /// From the next [`finish`](Self::finish) on equal rows are one, or are not.
    pub fn share_rows(&mut self, shares: bool) {
        self.shared = shares.then(|| self.shared.take().unwrap_or_default());
    }

    /// From the next [`finish`](Self::finish) on the last actions aim at these entities, one each; these columns of an
    /// agent's own row say how it stands to them, as many for each.
    pub fn aim_at(&mut self, targets: impl Iterator<Item = usize>, related: Range<usize>) {
        self.aims.aim_at(targets, related);
    }

    /// Forgets all states, keeps the memory.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.others.clear();
        self.timeline.clear();
        self.sizes.clear();
        self.available.clear();
        self.states.clear();
        self.queries.clear();
        self.hides = false;
    }

    /// Adds a state of which all rows have been observed, the first of an episode of its own.
    pub fn push(&mut self, seen: &Observation) {
        let episode = self.sizes.len();
        self.push_at(Moment { episode, ..Moment::default() }, seen, |_| EntitySet::MAX);
    }

    /// As [`push`](Self::push), of any moment of an episode; `within` gives the entities in the part of an agent.
    pub fn push_at(
        &mut self,
        moment: Moment,
        seen: &Observation,
        within: impl Fn(usize) -> EntitySet,
    ) {
        let agents = EntitySet::from(seen.acting());
        let others = seen.present & !agents;
        let (first_agent, first_other) = (self.rows.len(), self.others.len());
        self.states.push(Sets { agents, others, first_agent, first_other });
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

    /// Ends the pushing: lists who sees what, and where something is imagined in which part.
    pub fn finish(&mut self, imagines: bool) {
        self.imagines = imagines;
        let agents = self.rows.len();
        self.rows.append(&self.others);
        if let Some(shared) = &mut self.shared {
            shared.fill(&self.rows);
        }
        self.seen.clear();
        self.known.clear();
        self.aims.clear();
        let mut queries = (0..).zip(&self.queries);
        let mut rows = [0; EntitySet::BITS as usize];
        for sets in &self.states {
            for (entity, row) in sets.rows(agents) {
                rows[entity] =
                    self.shared.as_ref().map_or(row, |shared| shared.places[row] as usize);
            }
            let row = |entity: usize| rows[entity];
            for (number, query) in queries.by_ref().take(sets.agents.count_ones() as usize) {
                let part = if imagines { query.within } else { EntitySet::MAX };
                let list = |lists: &mut VisibleLists, seen: EntitySet| {
                    lists.push_parts(members(seen & part).map(row), members(seen & !part).map(row));
                };
                list(&mut self.seen, query.observable);
                let own = self.rows.row(number as usize);
                self.aims.push((number, own), query.observable, row);
                if self.hides {
                    list(&mut self.known, sets.agents | sets.others);
                }
            }
        }
        if imagines {
            // Whoever an agent is with in what is imagined, it aims at what it sees.
            self.aims.repeat(BLOCKS, self.queries.len());
        }
        self.number_teams();
        self.timeline.lay_out(imagines);
    }

    /// Says of every agent which team it is in, once for each imagined block.
    fn number_teams(&mut self) {
        self.teams.clear();
        for _ in 1..BLOCKS {
            let teams = self.sizes.iter().enumerate();
            let each = teams.flat_map(|(team, size)| std::iter::repeat_n(team as u32, *size));
            self.teams.extend(each);
        }
        self.team_sizes.clear();
        self.team_sizes.extend(self.sizes.iter().map(|size| *size as f32));
    }

    /// What agents see.
    pub fn seen(&self) -> View<'_> {
        self.view(&self.seen)
    }

    /// For each agent everything that exists in its state.
    pub fn known(&self) -> View<'_> {
        self.view(if self.hides { &self.known } else { &self.seen })
    }

    fn view<'a>(&'a self, lists: &'a VisibleLists) -> View<'a> {
        let (rows, own) = match &self.shared {
            Some(Shared { rows, places, .. }) => (rows, &places[..self.agents()]),
            None => (&self.rows, &[][..]),
        };
        View { rows, own, lists, imagines: self.imagines }
    }

    /// What aimed actions aim at in a view.
    pub fn aims(&self, view: View<'_>) -> AimView<'_> {
        let repeats = self.imagines && !view.imagines;
        self.aims.part(if repeats { BLOCKS } else { 1 })
    }

    /// Where the rows of a view stand among `[steps, blocks * slots]`, and who is there to remember.
    pub(super) fn in_time(&self, view: View<'_>) -> (&[u32], &[bool]) {
        let (places, carry) = &self.timeline.grids[usize::from(view.imagines)];
        (places, carry)
    }

    /// Memories that go through time side by side in a view: of all blocks, all episodes, all agents, whether they act or
    /// not.
    pub fn slots(&self, view: View<'_>) -> usize {
        let blocks = if view.imagines { BLOCKS } else { 1 };
        blocks * self.timeline.slots()
    }

    /// Whether there is no state.
    pub fn is_empty(&self) -> bool {
        self.sizes.is_empty()
    }

    /// Number of agents that act in every state.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// The agents of every state as a team, which knows everything that exists there.
    pub fn teams(&self) -> Teams<'_> {
        Teams { known: self.known(), numbers: &self.teams, sizes: &self.team_sizes }
    }

    /// The actions that each agent may take.
    pub fn available(&self) -> &[ActionSet] {
        &self.available
    }

    /// Agents that act in all states.
    pub fn agents(&self) -> usize {
        self.queries.len()
    }
}

impl Sets {
    /// The entities that exist and their rows, where so many rows are of agents.
    fn rows(&self, agents: usize) -> impl Iterator<Item = (usize, usize)> {
        let others = members(self.others).zip(agents + self.first_other..);
        members(self.agents).zip(self.first_agent..).chain(others)
    }
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

impl Timeline {
    fn clear(&mut self) {
        (self.steps, self.episodes) = (0, 0);
        self.rows.clear();
    }

    /// Adds a state of some agents, of which these act.
    fn push(&mut self, moment: Moment, agents: usize, acting: impl Iterator<Item = usize>) {
        self.steps = self.steps.max(moment.step + 1);
        self.episodes = self.episodes.max(moment.episode + 1);
        self.agents = agents;
        self.rows.extend(acting.map(|agent| (moment.step, moment.episode * agents + agent)));
    }

    fn slots(&self) -> usize {
        self.episodes * self.agents
    }

    /// Finds where every row stands, block by block.
    fn lay_out(&mut self, imagines: bool) {
        let slots = self.slots();
        for ((places, carry), blocks) in self.grids.iter_mut().zip([1, BLOCKS]) {
            places.clear();
            carry.clear();
            if blocks > 1 && !imagines {
                continue;
            }
            carry.resize(self.steps * blocks * slots, false);
            for block in 0..blocks {
                for (step, slot) in &self.rows {
                    let place = (step * blocks + block) * slots + slot;
                    places.push(place as u32);
                    carry[place] = true;
                }
            }
        }
    }
}
