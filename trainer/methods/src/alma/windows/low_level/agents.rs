//! The agents' utility network as the learner uses it (dissertation section 7.3).
//!
//! With the subtask mask an agent sees its team only; without it ("no mask") it sees everything, and a
//! subtask's embedding is added to what `fc1` gives for an entity: further rows of `fc1` for one-hot marks
//! behind the features. Which mark stands for which subtask is shuffled before each pass, so that no
//! subtask is special; spare marks let one network serve more subtasks than it was trained with.

use sortie_envs::random::below;
use sortie_nn::random::Generator;

use super::super::batch::WindowShape;
use super::config::LowLevelConfig;
use crate::alma::records::UtilityNetwork;

/// Draws a network uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does, of the embedding's first
/// layer as configured; marks are a layer of their own.
pub(super) fn initialise(
    config: &LowLevelConfig,
    sizes: WindowShape,
    generator: &mut Generator,
) -> UtilityNetwork {
    let shape = config.shape(sizes);
    let features = sizes.features + sizes.actions;
    let active = if config.active_inputs > 0.0 { config.active_inputs } else { features as f32 };
    let mut network = UtilityNetwork::initialise(shape, active, generator);
    let marks = shape.input - features;
    let factor = (active / marks.max(1) as f32).sqrt();
    let rows = &mut network.parameters_mut()[features * shape.width..shape.input * shape.width];
    rows.iter_mut().for_each(|weight| *weight *= factor);
    network
}

/// Which mark stands for which subtask: the column of subtask t at place t.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskOrder(pub(super) Vec<u16>);

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
