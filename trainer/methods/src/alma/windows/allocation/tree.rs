//! Allocations are proposed agent by agent: proposals that begin alike share what follows from it, as a tree.
//!
//! What they are about are the agents, open subtasks and other entities of some states, a block. Subtasks that are not open
//! are never chosen, and absent entities count for nothing: both are left out.
//!
//! A subtask with the agents that have joined it is a team. A team is computed once, whatever else the proposals around
//! it say.

use std::ops::Range;

use sortie_nn::layers::{SparseRows, VisibleLists};

use super::rows::{COUNT_SCALE, Shown, States};
use crate::alma::windows::NO_TASK;

/// Nothing stands here.
pub(super) const NONE: u32 = u32::MAX;

/// Who and what a block of states is about. States are counted from the block's first.
#[derive(Clone, Debug, Default)]
pub(super) struct Block {
    pub(super) states: Range<usize>,
    /// A
    pub(super) agents: usize,
    /// T
    pub(super) tasks: usize,
    /// How many agents each state allocates: its present ones, or none where no subtask is open.
    pub(super) levels: Vec<usize>,
    /// `[states, A]`: the agents that are allocated, one behind the other.
    pub(super) slots: Vec<u8>,
    /// `[states, A]`: their rows.
    pub(super) agent_rows: Vec<u32>,
    /// Rows of agents; those that others follow stand before the last ones of their states.
    pub(super) agent_count: usize,
    /// Rows of agents that others follow.
    pub(super) followed: usize,
    /// `[states, T]`: the number of each open subtask among all of the block, or [`NONE`].
    pub(super) open: Vec<u32>,
    /// The agents, then the other entities.
    pub(super) rows: SparseRows,
    /// For each other entity the number of its subtask.
    pub(super) entity_open: Vec<u32>,
    /// For each other entity those of the same subtask.
    pub(super) same_task: VisibleLists,
    /// Whether no subtask has several present entities.
    pub(super) alone: bool,
    /// For each open subtask its entities, present or not, times [`COUNT_SCALE`].
    pub(super) others: Vec<f32>,
    /// For each open subtask its present entities.
    pub(super) members: Vec<f32>,
}

impl Block {
    /// Lists the rows of some states.
    pub(super) fn of(shown: Shown<'_>, range: Range<usize>) -> Self {
        let states = shown.states;
        let mut block = Self {
            states: range.clone(),
            agents: states.agents,
            tasks: states.tasks,
            agent_rows: vec![NONE; range.len() * states.agents],
            alone: true,
            ..Self::default()
        };
        range.clone().for_each(|state| block.list_agents(states, state));
        block.push_agents(shown);
        range.for_each(|state| block.list_others(shown, state));
        block
    }

    /// Adds the rows of all agents that are allocated, the last ones of their states behind all others.
    fn push_agents(&mut self, shown: Shown<'_>) {
        for local in 0..self.len() {
            let followed = 0..self.levels[local].saturating_sub(1);
            followed.for_each(|level| self.push_agent(shown, local, level));
        }
        self.followed = self.rows.len();
        for local in 0..self.len() {
            if let Some(last) = self.levels[local].checked_sub(1) {
                self.push_agent(shown, local, last);
            }
        }
        self.agent_count = self.rows.len();
    }

    fn push_agent(&mut self, shown: Shown<'_>, local: usize, level: usize) {
        let index = local * self.agents + level;
        let (state, agent) = (self.states.start + local, usize::from(self.slots[index]));
        self.agent_rows[index] = self.rows.len() as u32;
        shown.begin_row(state, agent, shown.states.last_allocation(state)[agent], &mut self.rows);
        self.rows.end_row();
    }

    fn list_agents(&mut self, states: &States, state: usize) {
        let any_open = states.open(state).contains(&true);
        let present = (0..).zip(&states.present(state)[..self.agents]);
        let start = self.slots.len();
        self.slots.extend(present.filter(|(_, here)| **here && any_open).map(|(agent, _)| agent));
        self.levels.push(self.slots.len() - start);
        self.slots.resize(start + self.agents, 0);
    }

    fn list_others(&mut self, shown: Shown<'_>, state: usize) {
        let (states, start) = (shown.states, self.open.len());
        for (task, open) in (0..).zip(states.open(state)) {
            self.open.push(if *open { self.others.len() as u32 } else { NONE });
            if *open {
                self.others.push(COUNT_SCALE * states.others(state, task) as f32);
                self.members.push(0.0);
            }
        }
        let open = self.open[start..].to_vec();
        let first = self.entity_open.len();
        for entity in self.agents..states.entities {
            let task = states.entity_task(state)[entity];
            if !states.present(state)[entity] || task == NO_TASK {
                continue;
            }
            let number = open[usize::from(task)];
            if number != NONE {
                self.entity_open.push(number);
                self.members[number as usize] += 1.0;
                self.alone &= self.members[number as usize] < 2.0;
                shown.begin_row(state, entity, task, &mut self.rows);
                self.rows.end_row();
            }
        }
        for entity in first..self.entity_open.len() {
            let number = self.entity_open[entity];
            let same = (first..self.entity_open.len()).filter(|e| self.entity_open[*e] == number);
            same.for_each(|row| self.same_task.push(row));
            self.same_task.end_list();
        }
    }

    pub(super) fn open_count(&self) -> usize {
        self.others.len()
    }

    pub(super) fn len(&self) -> usize {
        self.levels.len()
    }

    /// Where the row of an agent of a state stands.
    pub(super) fn agent(&self, state: u32, level: u32) -> u32 {
        self.agent_rows[state as usize * self.agents + level as usize]
    }
}

/// The logarithm of the probability of what cannot be chosen: none, yet a number that can be calculated with.
pub(super) const IMPOSSIBLE: f32 = -1e9;

/// Whether a choice is possible by the logarithm of its probability.
pub(super) fn is_possible(chance: f32) -> bool {
    chance > 0.5 * IMPOSSIBLE
}

/// One team at one subtask of one state.
#[derive(Clone, Copy, Debug)]
pub(super) struct Team {
    /// The team before the last agent joined, or [`NONE`].
    pub(super) before: u32,
    /// The last agent's row.
    pub(super) joined: u32,
    /// Where the product stands that all who join need, or [`NONE`].
    pub(super) product: u32,
    /// Agents, times [`COUNT_SCALE`].
    pub(super) size: f32,
    /// Other entities of the subtask, times [`COUNT_SCALE`].
    pub(super) others: f32,
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
    /// Its row among those of its level that are not whole.
    pub(super) row: u32,
    /// Sum of the log-probabilities of the choices.
    pub(super) log_probability: f32,
}

/// The logits that the prefixes of a level ask for, each of an agent at a team.
#[derive(Debug, Default)]
pub(super) struct Asked {
    pub(super) agents: Vec<u32>,
    pub(super) teams: Vec<u32>,
    /// `[prefixes, T]`: the logit of each choice; those behind the last are impossible.
    pub(super) places: Vec<u32>,
}

/// The prefixes of all proposals of a block of states, and their teams.
#[derive(Debug, Default)]
pub(super) struct Tree {
    tasks: usize,
    agents: usize,
    pub(super) prefixes: Vec<Prefix>,
    /// `[prefixes, T]`: the team at each subtask.
    teams_of: Vec<u32>,
    /// `[prefixes, T]`: the longer prefix after each choice, or [`NONE`].
    longer: Vec<u32>,
    /// `[states, P]`: how far each proposal has come.
    pub(super) at: Vec<u32>,
    pub(super) teams: Vec<Team>,
    /// `[teams, A]`: the team after the agent of each level has joined, or [`NONE`].
    after: Vec<u32>,
    /// The team that each product is about.
    pub(super) products_of: Vec<u32>,
}

impl Tree {
    /// Begins the proposals of a block, to whose subtasks nobody belongs yet.
    pub(super) fn begin(block: &Block, proposals: usize) -> Self {
        let mut tree = Self { tasks: block.tasks, agents: block.agents, ..Self::default() };
        for others in &block.others {
            let (before, joined, product) = (NONE, NONE, NONE);
            tree.push_team(Team { before, joined, product, size: 0.0, others: *others });
        }
        for (state, roots) in (0..).zip(block.open.chunks_exact(block.tasks)) {
            let count = proposals as u32;
            let (parent, log_probability) = (NONE, 0.0);
            let root =
                Prefix { state, parent, level: 0, task: 0, count, row: NONE, log_probability };
            let index = tree.push(root, |teams| teams.extend_from_slice(roots));
            tree.at.extend((0..proposals).map(|_| index));
        }
        tree
    }

    fn push(&mut self, prefix: Prefix, extend_teams: impl FnOnce(&mut Vec<u32>)) -> u32 {
        let index = self.prefixes.len() as u32;
        self.prefixes.push(prefix);
        extend_teams(&mut self.teams_of);
        let length = self.prefixes.len() * self.tasks;
        self.longer.resize(length, NONE);
        index
    }

    fn push_team(&mut self, team: Team) -> u32 {
        self.teams.push(team);
        self.after.resize(self.teams.len() * self.agents, NONE);
        (self.teams.len() - 1) as u32
    }

    /// Whether a prefix has allocated all agents of its state.
    fn is_whole(block: &Block, prefix: &Prefix) -> bool {
        prefix.level as usize == block.levels[prefix.state as usize]
    }

    /// Lists the logits that some prefixes of one level need for their next choices, each once.
    pub(super) fn ask(&mut self, block: &Block, prefixes: Range<usize>) -> Asked {
        let mut asked = Asked::default();
        let mut place_of = vec![NONE; self.teams.len()];
        let mut row = 0;
        for index in prefixes {
            let prefix = &mut self.prefixes[index];
            if Self::is_whole(block, prefix) {
                continue;
            }
            prefix.row = row;
            row += 1;
            let agent = block.agent(prefix.state, prefix.level);
            for team in &self.teams_of[index * self.tasks..][..self.tasks] {
                let place = place_of.get_mut(*team as usize).map_or(NONE, |place| {
                    if *place == NONE {
                        *place = asked.teams.len() as u32;
                        asked.teams.push(*team);
                        asked.agents.push(agent);
                    }
                    *place
                });
                asked.places.push(place);
            }
        }
        let behind = asked.teams.len() as u32;
        asked.places.iter_mut().filter(|place| **place == NONE).for_each(|place| *place = behind);
        asked
    }

    /// Leads a proposal on by the choice for an agent, whose logarithm of a probability this is; where nobody has chosen so
    /// before, the agent joins the team, if others `follow` who see it there.
    pub(super) fn choose(
        &mut self,
        proposal: usize,
        (task, chance): (usize, f32),
        (agent, follow): (u32, bool),
    ) {
        let from = self.at[proposal] as usize;
        let place = from * self.tasks + task;
        if self.longer[place] == NONE {
            let Prefix { state, level, log_probability, .. } = self.prefixes[from];
            let team = self.teams_of[place];
            let team = if follow { self.join(team, level, agent) } else { team };
            let longer = Prefix {
                state,
                parent: from as u32,
                level: level + 1,
                task: task as u8,
                count: 0,
                row: NONE,
                log_probability: log_probability + chance,
            };
            let tasks = self.tasks;
            self.longer[place] = self.push(longer, |teams| {
                teams.extend_from_within(from * tasks..(from + 1) * tasks);
                let last = teams.len() - tasks + task;
                teams[last] = team;
            });
        }
        let next = self.longer[place];
        self.prefixes[next as usize].count += 1;
        self.at[proposal] = next;
    }

    /// The team after a level's agent, who is a row, has joined.
    fn join(&mut self, team: u32, level: u32, row: u32) -> u32 {
        let place = team as usize * self.agents + level as usize;
        if self.after[place] == NONE {
            let before = &mut self.teams[team as usize];
            if before.product == NONE {
                before.product = self.products_of.len() as u32;
                self.products_of.push(team);
            }
            let Team { size, others, .. } = *before;
            let size = size + COUNT_SCALE;
            self.after[place] =
                self.push_team(Team { before: team, joined: row, product: NONE, size, others });
        }
        self.after[place]
    }

    /// A prefix and all shorter ones down to one agent.
    pub(super) fn way_back(&self, prefix: u32) -> impl Iterator<Item = &Prefix> {
        let at = |index: u32| self.prefixes.get(index as usize);
        std::iter::successors(at(prefix), move |prefix| at(prefix.parent))
            .take_while(|prefix| prefix.level > 0)
    }
}
