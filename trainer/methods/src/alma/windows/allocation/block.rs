//! What the proposals of some states are about: their agents, open subtasks and other entities.
//!
//! Subtasks that are not open are never chosen, and absent entities count for nothing: both are left out.

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
