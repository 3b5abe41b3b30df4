//! Which mark stands for which subtask.

use sortie_envs::random::below;
use sortie_nn::random::Generator;

/// Which mark stands for which subtask: the column of subtask t at place t.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskOrder(pub(crate) Vec<u16>);

impl TaskOrder {
    /// Every subtask has the mark of its number: how agents are deployed.
    pub fn identity(tasks: usize) -> Self {
        Self((0..tasks as u16).collect())
    }

    /// An order in which column j stands for subtask `tasks[j]`.
    pub fn of_columns(tasks: &[usize]) -> Self {
        let mut columns = vec![0; tasks.len()];
        (0..).zip(tasks).for_each(|(column, task)| columns[*task] = column);
        Self(columns)
    }

    /// Draws an order of so many subtasks and spare marks.
    pub fn shuffled(tasks: usize, generator: &mut Generator) -> Self {
        let mut columns: Vec<u16> = (0..tasks as u16).collect();
        for end in (1..tasks).rev() {
            columns.swap(end, below(generator, end + 1));
        }
        Self(columns)
    }
}
