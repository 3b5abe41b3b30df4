//! The states in which agents are to be allocated.

use sortie_envs::Observation;
use sortie_nn::layers::SparseRows;

use super::super::batch::NO_TASK;

/// One state as plain slices. N entities, of which the first A are the agents; T subtasks.
#[derive(Clone, Copy, Debug)]
pub struct StateView<'a> {
    /// Rows of features, of which N from `first_row` on belong to this state.
    pub features: &'a SparseRows,
    /// The row of entity 0.
    pub first_row: usize,
    /// `[N]`: the entities that exist.
    pub present: &'a [bool],
    /// `[N]`: the subtask of every entity or [`NO_TASK`]. Those of agents are the allocation to be valued;
    /// where agents are to be allocated they do not matter.
    pub entity_task: &'a [u8],
    /// `[T]`: the subtasks that exist and are not finished.
    pub open: &'a [bool],
    /// `[A]`: the allocation that was in force before; all [`NO_TASK`] at the beginning of an episode.
    pub last_allocation: &'a [u8],
}

/// Any number of states of the same sizes, row-major with the states in front.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct States {
    pub(super) agents: usize,
    pub(super) entities: usize,
    pub(super) tasks: usize,
    pub(super) features: SparseRows,
    pub(super) present: Vec<bool>,
    pub(super) entity_task: Vec<u8>,
    pub(super) open: Vec<bool>,
    pub(super) last_allocation: Vec<u8>,
}

impl States {
    /// No states yet, of A agents among N entities and T subtasks.
    pub fn new(agents: usize, entities: usize, tasks: usize) -> Self {
        Self { agents, entities, tasks, ..Self::default() }
    }

    /// Forgets all states, keeps the memory.
    pub fn clear(&mut self) {
        self.features.clear();
        self.present.clear();
        self.entity_task.clear();
        self.open.clear();
        self.last_allocation.clear();
    }

    /// Adds a state. Panics if a slice has another length than the sizes say.
    pub fn push(&mut self, state: StateView<'_>) {
        assert_eq!(state.present.len(), self.entities, "entities");
        assert_eq!(state.entity_task.len(), self.entities, "entities with tasks");
        assert_eq!(state.open.len(), self.tasks, "subtasks");
        assert_eq!(state.last_allocation.len(), self.agents, "agents");
        for row in state.first_row..state.first_row + self.entities {
            state.features.row(row).for_each(|(column, value)| self.features.push(column, value));
            self.features.end_row();
        }
        self.present.extend_from_slice(state.present);
        self.entity_task.extend_from_slice(state.entity_task);
        self.open.extend_from_slice(state.open);
        self.last_allocation.extend_from_slice(state.last_allocation);
    }

    /// Adds a state of which everything was observed, with the allocation `[A]` that was in force before. Panics if it
    /// has other sizes; of its subtasks, those that exist count.
    pub fn push_seen(&mut self, seen: &Observation, last_allocation: &[u8]) {
        assert_eq!(seen.entity_task.len(), self.entities, "entities");
        assert_eq!(last_allocation.len(), self.agents, "agents");
        for entity in 0..self.entities {
            let exists = seen.present >> entity & 1 == 1;
            if exists {
                self.features.push_row(&seen.rows, seen.row_of(entity));
            }
            self.features.end_row();
            self.present.push(exists);
            self.entity_task.push(seen.task_of(entity));
        }
        self.open.extend((0..self.tasks).map(|task| seen.open_tasks >> task & 1 == 1));
        self.last_allocation.extend_from_slice(last_allocation);
    }

    /// How many states there are.
    pub fn len(&self) -> usize {
        self.open.len() / self.tasks.max(1)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The allocation `[A]` that stands in a state.
    pub fn allocation(&self, state: usize) -> &[u8] {
        &self.entity_task[state * self.entities..][..self.agents]
    }

    pub(super) fn present(&self, state: usize) -> &[bool] {
        &self.present[state * self.entities..][..self.entities]
    }

    pub(super) fn entity_task(&self, state: usize) -> &[u8] {
        &self.entity_task[state * self.entities..][..self.entities]
    }

    pub(super) fn open(&self, state: usize) -> &[bool] {
        &self.open[state * self.tasks..][..self.tasks]
    }

    pub(super) fn last_allocation(&self, state: usize) -> &[u8] {
        &self.last_allocation[state * self.agents..][..self.agents]
    }

    /// Copies an entity's features into a row that is not closed yet.
    pub(super) fn copy_features(&self, state: usize, entity: usize, to: &mut SparseRows) {
        let row = self.features.row(state * self.entities + entity);
        row.for_each(|(column, value)| to.push(column, value));
    }

    /// Entities of a task that are no agents, present or not.
    pub(super) fn others(&self, state: usize, task: u8) -> usize {
        let others = &self.entity_task(state)[self.agents..];
        others.iter().filter(|of| **of == task).count()
    }
}

/// Agents that an allocation gives to a task.
pub(super) fn team_size(allocation: &[u8], task: u8) -> usize {
    allocation.iter().filter(|of| **of == task && task != NO_TASK).count()
}
