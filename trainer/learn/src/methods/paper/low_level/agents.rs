//! The agents' utility network as the learner uses it (dissertation section 7.3).
//!
//! With the subtask mask an agent sees its team only; without it ("no mask") it sees everything, and a
//! subtask's embedding is added to what `fc1` gives for an entity: further rows of `fc1` for one-hot marks
//! behind the features. Which mark stands for which subtask is shuffled before each pass, so that no
//! subtask is special; spare marks let one network serve more subtasks than it was trained with.

use super::super::windows::{WindowShape, Windows};
use super::config::LowLevelConfig;
use super::teams::{Teams, View};
use crate::methods::alma::{Conditioning, UtilityInput, UtilityNetwork, UtilityPass, UtilityShape};
use crate::random::{Generator, below};

/// The sizes of the utility network in an environment of these sizes.
pub(super) fn utility_shape(config: &LowLevelConfig, sizes: WindowShape) -> UtilityShape {
    let marks = config.conditioning.task_columns(sizes.tasks + config.extra_tasks);
    UtilityShape {
        input: sizes.features + sizes.actions + marks,
        width: config.width,
        heads: config.heads,
        base: config.base,
        actions: sizes.actions,
    }
}

/// Draws a network uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does; marks are a layer of
/// their own.
pub(super) fn initialise(
    config: &LowLevelConfig,
    sizes: WindowShape,
    generator: &mut Generator,
) -> UtilityNetwork {
    let shape = utility_shape(config, sizes);
    let features = sizes.features + sizes.actions;
    let mut network = UtilityNetwork::initialise(shape, features as f32, generator);
    let marks = shape.input - features;
    let factor = (features as f32 / marks.max(1) as f32).sqrt();
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

/// Acting: the utilities of all agents of many states at once.
#[derive(Clone, Debug)]
pub struct AgentPass {
    conditioning: Conditioning,
    teams: Teams,
    input: UtilityInput,
    pass: UtilityPass,
    utilities: Vec<f32>,
}

impl AgentPass {
    /// Empty buffers for networks of a shape.
    pub fn new(conditioning: Conditioning, shape: UtilityShape) -> Self {
        Self {
            conditioning,
            teams: Teams::default(),
            input: UtilityInput::default(),
            pass: UtilityPass::new(shape),
            utilities: Vec::new(),
        }
    }

    /// Computes the utilities `[W S, A, U]` in all states of `windows`, zeros for absent agents.
    ///
    /// Environments that run side by side are windows of one step. Read are features, `present`,
    /// `observable`, `entity_task` and `last_actions`.
    pub fn forward(
        &mut self,
        network: &UtilityNetwork,
        windows: &Windows,
        order: &TaskOrder,
    ) -> &[f32] {
        let shape = windows.shape;
        self.teams.clear();
        for state in 0..shape.states() {
            self.teams.push(View::NOW.of(windows, state), state, None);
        }
        let marks = (self.conditioning == Conditioning::Input).then_some(&*order.0);
        let conditioning = (self.conditioning, marks);
        self.teams.write_agents((windows, View::NOW), conditioning, &mut self.input);
        let utilities = self.pass.forward(network, &self.input);
        self.utilities.clear();
        self.utilities.resize(shape.states() * shape.agents * shape.actions, 0.0);
        let rows = utilities.chunks_exact(shape.actions.max(1));
        for (row, (state, agent)) in rows.zip(self.teams.agents()) {
            let at = (state * shape.agents + agent) * shape.actions;
            self.utilities[at..][..shape.actions].copy_from_slice(row);
        }
        &self.utilities
    }
}
