//! Entities of a state as rows of a network's input.

use sortie_nn::layers::SparseRows;

use super::super::batch::{NO_ACTION, NO_TASK, Windows};

/// One state, seen with the subtasks that hold at a state: usually the same, or the one before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene<'a> {
    pub(super) windows: &'a Windows,
    /// Whose entities there are.
    pub(super) state: usize,
    /// Whose subtasks and allocation hold.
    pub(super) tasks_of: usize,
}

/// The columns that mark an entity's subtask: the one of subtask t stands at place t, counted from the
/// first behind features and last action.
pub(super) type Marks<'a> = Option<&'a [u16]>;

impl Scene<'_> {
    pub(super) fn present(self, entity: usize) -> bool {
        self.windows.present[self.state * self.windows.shape.entities + entity]
    }

    /// The subtask of an entity, or [`NO_TASK`].
    pub(super) fn task(self, entity: usize) -> u8 {
        self.windows.entity_task[self.tasks_of * self.windows.shape.entities + entity]
    }

    /// Whether two entities work on a subtask together.
    pub(super) fn share_task(self, a: usize, b: usize) -> bool {
        self.task(a) != NO_TASK && self.task(a) == self.task(b)
    }

    pub(super) fn observes(self, agent: usize, entity: usize) -> bool {
        let shape = self.windows.shape;
        let row = self.state * shape.agents + agent;
        self.windows.observable[row * shape.entities + entity] && self.present(entity)
    }

    /// Adds the row of an entity: its features, its last action's one-hot, its subtask's mark.
    pub(super) fn write(self, entity: usize, marks: Marks<'_>, rows: &mut SparseRows) {
        let shape = self.windows.shape;
        for (column, value) in self.windows.features.row(self.state * shape.entities + entity) {
            rows.push(column, value);
        }
        if entity < shape.agents {
            let last = self.windows.last_actions[self.state * shape.agents + entity];
            if last != NO_ACTION {
                rows.push(shape.features + usize::from(last), 1.0);
            }
        }
        if let Some(column) = marks.and_then(|marks| marks.get(usize::from(self.task(entity)))) {
            rows.push(shape.features + shape.actions + usize::from(*column), 1.0);
        }
        rows.end_row();
    }
}

/// Rows of many states; each entity of a state gets a row when it is first asked for.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    /// `[N]`: the row of every entity of the current state, or [`NOWHERE`].
    rows: Vec<u32>,
}

const NOWHERE: u32 = u32::MAX;

impl Places {
    /// Begins a state whose `agents` have rows already, from row `first` on.
    pub(super) fn begin(&mut self, entities: usize, first: usize, agents: &[u8]) {
        self.rows.clear();
        self.rows.resize(entities, NOWHERE);
        for (row, agent) in (first..).zip(agents) {
            self.rows[usize::from(*agent)] = row as u32;
        }
    }

    /// The row of an entity, which is added where it has none.
    pub(super) fn row(
        &mut self,
        scene: Scene<'_>,
        entity: usize,
        marks: Marks<'_>,
        rows: &mut SparseRows,
    ) -> usize {
        if self.rows[entity] == NOWHERE {
            self.rows[entity] = rows.len() as u32;
            scene.write(entity, marks, rows);
        }
        self.rows[entity] as usize
    }
}
