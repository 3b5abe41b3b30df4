//! Teams at subtasks, written as input of the team-value network.

use std::ops::Range;

use sortie_envs::{EntitySet, Environment, Observation, SparseRows, Spec, members};

use crate::alma::agents::{UtilityInput, UtilityShape};
use crate::alma::records::config::AllocatorConfig;

/// What the columns of a row are: an entity's features, its part in the question, its relation to the subtask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TeamColumns {
    features: usize,
    relations: usize,
    /// The first and the end of those in agents' rows that say how each stands to what it may aim at.
    pairs: [usize; 2],
}

impl TeamColumns {
    /// Those of an environment.
    pub fn of(spec: &Spec) -> Self {
        let pairs = [spec.pairs.start, spec.pairs.end];
        Self { features: spec.shape.features, relations: spec.relations, pairs }
    }

    /// Their number.
    pub fn count(self) -> usize {
        self.relation() + self.relations
    }

    /// Those that rows are without: what is told of each pair of an agent and a target is for who aims. To tell what a team
    /// is worth they only hide the rest.
    pub(in crate::alma::records) fn pairs(self) -> Range<usize> {
        self.pairs[0]..self.pairs[1]
    }

    /// Marks the subtask's things; the first of them asks.
    pub(in crate::alma::records) fn own(self) -> usize {
        self.features
    }

    /// Marks the agents of the team.
    fn in_team(self) -> usize {
        self.features + 1
    }

    /// First of the columns that say how an entity stands to the subtask.
    pub(in crate::alma::records) fn relation(self) -> usize {
        self.features + 2
    }
}

impl AllocatorConfig {
    /// The network's shape in an environment: one output, the value.
    pub fn shape(&self, spec: &Spec) -> UtilityShape {
        self.network.shape(TeamColumns::of(spec).count(), 1)
    }
}

/// A team at a subtask.
#[derive(Clone, Copy, Debug)]
pub struct TeamQuery<'a> {
    /// The state.
    pub state: &'a [u8],
    /// The subtask, which is open.
    pub task: usize,
    /// Bit a set where agent a is in the team.
    pub team: u64,
    /// Number of the symmetry under which the state is seen.
    pub turn: usize,
}

impl TeamQuery<'_> {
    /// Whether it looks at the same things as another, maybe of another subtask.
    fn looks_as(&self, other: &Self) -> bool {
        std::ptr::eq(self.state, other.state) && self.turn == other.turn
    }
}

/// Any number of teams as input of the network, which gives one value for each.
#[derive(Clone, Debug, Default)]
pub struct TeamValueInput {
    input: UtilityInput,
    /// The rows behind those of the subtasks' own things.
    others: SparseRows,
    seen: Observation,
    /// Of every entity that is seen how it stands to a subtask.
    relations: SparseRows,
}

impl TeamValueInput {
    /// Writes independent queries, each with its own rows.
    pub fn queries<'a>(
        &mut self,
        environment: &dyn Environment,
        queries: impl Iterator<Item = TeamQuery<'a>> + Clone,
    ) -> &UtilityInput {
        self.clear();
        let columns = TeamColumns::of(environment.spec());
        let count = queries.clone().count();
        let mut before: Option<TeamQuery<'_>> = None;
        for (index, query) in queries.enumerate() {
            let TeamQuery { state, task, team, turn } = query;
            let looks_as_before = before.is_some_and(|before| query.looks_as(&before));
            if !looks_as_before {
                environment.observe(state, turn, EntitySet::MAX, &mut self.seen);
            }
            if !looks_as_before || before.is_some_and(|before| before.task != task) {
                self.relate(environment, query);
            }
            let own = self.own(task);
            self.push_own(columns, own);
            self.input.visible.push(index);
            let first = self.others.len();
            for agent in members(self.seen.acting().into()) {
                self.push_agent(columns, agent, team >> agent & 1 == 1);
            }
            self.push_others(columns, task, own);
            (first..self.others.len()).for_each(|row| self.input.visible.push(count + row));
            self.input.visible.end_list();
            before = Some(query);
        }
        self.input.rows.append(&self.others);
        &self.input
    }

    /// Writes every team of the acting agents at every open subtask: `[open subtasks, 2^A]` queries. Bit i of a team stands
    /// for the i-th of them.
    ///
    /// The teams at a subtask share its other rows: each agent once as member and once not.
    pub fn all_teams(&mut self, environment: &dyn Environment, state: &[u8]) -> &UtilityInput {
        self.clear();
        let columns = TeamColumns::of(environment.spec());
        environment.observe(state, 0, EntitySet::MAX, &mut self.seen);
        let acting = members(self.seen.acting().into());
        let agents = acting.clone().count();
        let (teams, open) = (0..1_usize << agents, self.seen.open_tasks);
        let count = open.count_ones() as usize * teams.len();
        for (place, task) in members(open).enumerate() {
            self.relate(environment, TeamQuery { state, task, team: 0, turn: 0 });
            let own = self.own(task);
            teams.clone().for_each(|_| self.push_own(columns, own));
            let first = count + self.others.len();
            for agent in acting.clone() {
                self.push_agent(columns, agent, false);
                self.push_agent(columns, agent, true);
            }
            let others = count + self.others.len();
            self.push_others(columns, task, own);
            let end = count + self.others.len();
            let visible = &mut self.input.visible;
            for team in teams.clone() {
                visible.push(place * teams.len() + team);
                (0..agents).for_each(|a| visible.push(first + 2 * a + (team >> a & 1)));
                (others..end).for_each(|row| visible.push(row));
                visible.end_list();
            }
        }
        self.input.rows.append(&self.others);
        &self.input
    }

    fn clear(&mut self) {
        self.input.clear();
        self.others.clear();
    }

    fn relate(&mut self, environment: &dyn Environment, query: TeamQuery<'_>) {
        let TeamQuery { state, task, turn, .. } = query;
        self.relations.clear();
        environment.relate(state, turn, task, EntitySet::MAX, &mut self.relations);
    }

    /// The first thing of a subtask, and its row.
    fn own(&self, task: usize) -> Option<(usize, usize)> {
        let own = members(self.seen.things_of(task)).next();
        own.map(|own| (own, self.seen.row_of(own)))
    }

    /// The row of the subtask's own thing.
    fn push_own(&mut self, columns: TeamColumns, own: Option<(usize, usize)>) {
        let rows = &mut self.input.rows;
        if let Some((_, row)) = own {
            rows.push_row(&self.seen.rows, row);
        }
        rows.push(columns.own(), 1.0);
        rows.end_row();
    }

    /// An agent's row; those of agents come first, as everything was observed.
    fn push_agent(&mut self, columns: TeamColumns, agent: usize, in_team: bool) {
        let (pairs, row) = (columns.pairs(), self.seen.rows.row(agent));
        let own = row.filter(|(column, _)| !pairs.contains(column));
        own.for_each(|(column, value)| self.others.push(column, value));
        if in_team {
            self.others.push(columns.in_team(), 1.0);
        }
        self.end_row(columns, agent);
    }

    /// The rows of the things of open subtasks but the one that asks.
    fn push_others(&mut self, columns: TeamColumns, task: usize, own: Option<(usize, usize)>) {
        let (things, of_task) = (members(self.seen.things()), self.seen.things_of(task));
        for (row, thing) in (self.seen.agents()..).zip(things) {
            let is_open = self.seen.entity_task[thing] & self.seen.open_tasks != 0;
            if is_open && own.is_none_or(|(own, _)| own != thing) {
                self.others.push_row(&self.seen.rows, row);
                if of_task >> thing & 1 == 1 {
                    self.others.push(columns.own(), 1.0);
                }
                self.end_row(columns, row);
            }
        }
    }

    /// Adds an entity's relation to the row that is written and closes it.
    fn end_row(&mut self, columns: TeamColumns, row: usize) {
        self.others.push_row_at(columns.relation(), &self.relations, row);
        self.others.end_row();
    }
}
