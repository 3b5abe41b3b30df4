//! Allocations as the critic sees them.
//!
//! Dissertation section 7.2.1 and the public code's allocation critic. What an entity looks like depends
//! on its subtask and on how many work there, not on the rest of the allocation: allocations of one state
//! share these rows. Absent entities are left out.

use sortie_nn::layers::{SparseRows, VisibleLists};

use super::block::NONE;
use super::rows::{COUNT_SCALE, Shown, States, team_size};
use crate::alma::windows::NO_TASK;

/// Allocations to be valued, with what their rows share.
#[derive(Clone, Debug, Default)]
pub(super) struct CriticInput {
    /// Distinct entities.
    pub(super) rows: SparseRows,
    /// Those of them that are agents, which query.
    pub(super) agent_rows: Vec<u32>,
    /// For each query its agent among them.
    pub(super) query_agents: Vec<u32>,
    /// For each query the rows of its allocation.
    pub(super) visible: VisibleLists,
    /// For each query its allocation.
    pub(super) allocation_of: Vec<u32>,
    pub(super) allocations: usize,
    /// A
    pub(super) slots: usize,
    /// The rows of the present state by entity, task and team size, or [`NONE`].
    known: Vec<u32>,
    /// For each row its place among the agents' rows, or [`NONE`].
    agent_of_row: Vec<u32>,
    list: Vec<u32>,
}

impl CriticInput {
    pub(super) fn clear(&mut self) {
        self.rows.clear();
        self.agent_rows.clear();
        self.query_agents.clear();
        self.visible.clear();
        self.allocation_of.clear();
        self.allocations = 0;
        self.agent_of_row.clear();
    }

    /// Begins with another state: no row is known.
    pub(super) fn begin_state(&mut self, states: &States) {
        self.slots = states.agents;
        let keys = states.entities * (states.tasks + 1) * (states.agents + 1);
        self.known.clear();
        self.known.resize(keys, NONE);
    }

    /// Adds an allocation `[A]` of the state begun last.
    pub(super) fn push(&mut self, shown: Shown<'_>, state: usize, allocation: &[u8]) {
        let states = shown.states;
        let present = states.present(state);
        let task_of = |entity: usize| match allocation.get(entity) {
            Some(task) => *task,
            None => states.entity_task(state)[entity],
        };
        self.list.clear();
        for entity in (0..states.entities).filter(|entity| present[*entity]) {
            let task = task_of(entity);
            let size = team_size(allocation, task);
            let task_key = if task == NO_TASK { states.tasks } else { usize::from(task) };
            let key = (entity * (states.tasks + 1) + task_key) * (states.agents + 1) + size;
            if self.known[key] == NONE {
                self.known[key] = self.rows.len() as u32;
                let is_agent = entity < states.agents;
                self.agent_of_row.push(if is_agent { self.agent_rows.len() as u32 } else { NONE });
                if is_agent {
                    self.agent_rows.push(self.known[key]);
                }
                if shown.begin_row(state, entity, task, &mut self.rows) {
                    let first = shown.shape.features + shown.shape.columns;
                    let counts = [size, states.others(state, task), 1];
                    for (place, count) in counts.into_iter().enumerate().filter(|it| it.1 > 0) {
                        self.rows.push(first + place, COUNT_SCALE * count as f32);
                    }
                }
                self.rows.end_row();
            }
            self.list.push(self.known[key]);
        }
        for row in &self.list {
            let agent = self.agent_of_row[*row as usize];
            if agent != NONE {
                self.query_agents.push(agent);
                self.allocation_of.push(self.allocations as u32);
                self.list.iter().for_each(|row| self.visible.push(*row as usize));
                self.visible.end_list();
            }
        }
        self.allocations += 1;
    }
}
