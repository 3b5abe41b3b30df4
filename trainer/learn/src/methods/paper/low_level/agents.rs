//! The agents' utility network as the learner uses it (dissertation section 7.3).
//!
//! With the subtask mask an agent sees its team only; without it ("no mask") it sees everything, and a
//! subtask's embedding is added to what `fc1` gives for an entity: further rows of `fc1` for one-hot marks
//! behind the features. Which mark stands for which subtask is shuffled before each pass, so that no
//! subtask is special; spare marks let one network serve more subtasks than it was trained with.

use super::super::windows::{WindowShape, Windows};
use super::config::LowLevelConfig;
use super::teams::{Teams, View};
use crate::layers::gru::{GruPass, GruShape};
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
    gru: GruPass,
    base: Vec<f32>,
    remembered: Vec<f32>,
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
            gru: GruPass::default(),
            base: Vec::new(),
            remembered: Vec::new(),
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
        self.look(windows, order);
        let rows = self.pass.forward(network, &self.input);
        spread(rows, windows.shape.actions, windows, &self.teams, &mut self.utilities);
        &self.utilities
    }

    /// The same for agents with a memory, which is `[W S, A, R]` and becomes that after this step.
    ///
    /// The caller empties it at the begin of an episode; that of absent agents is emptied here.
    pub fn forward_recurrent(
        &mut self,
        (network, gru): (&UtilityNetwork, &[f32]),
        windows: &Windows,
        order: &TaskOrder,
        memory: &mut [f32],
    ) -> &[f32] {
        self.look(windows, order);
        let (width, agents) = (network.shape().base, windows.shape.agents);
        let rows = self.pass.forward_base(network, &self.input);
        spread(rows, width, windows, &self.teams, &mut self.base);
        let present = |index: usize| {
            windows.present[index / agents * windows.shape.entities + index % agents]
        };
        let slots = windows.shape.states() * agents;
        let carry: Vec<bool> = (0..slots).map(present).collect();
        self.remembered.resize(slots * width, 0.0);
        let (input, shape) = ((&*self.base, &*carry), GruShape { width, slots });
        self.gru.forward(shape, gru, input, memory, &mut self.remembered);
        let utilities = self.pass.forward_head(network, &self.remembered);
        self.utilities.clear();
        self.utilities.extend_from_slice(utilities);
        let rows = self.utilities.chunks_exact_mut(windows.shape.actions.max(1));
        rows.zip(&carry).filter(|(_, present)| !**present).for_each(|(row, _)| row.fill(0.0));
        &self.utilities
    }

    /// Writes what all agents of all states see.
    fn look(&mut self, windows: &Windows, order: &TaskOrder) {
        self.teams.clear();
        for state in 0..windows.shape.states() {
            self.teams.push(View::NOW.of(windows, state), state, None);
        }
        let marks = (self.conditioning == Conditioning::Input).then_some(&*order.0);
        let conditioning = (self.conditioning, marks);
        self.teams.write_agents((windows, View::NOW), conditioning, &mut self.input);
    }
}

/// Writes the rows of the agents of some teams to their places in `[W S, A, width]`, the others being
/// zeros.
fn spread(rows: &[f32], width: usize, windows: &Windows, teams: &Teams, out: &mut Vec<f32>) {
    out.clear();
    out.resize(windows.shape.states() * windows.shape.agents * width, 0.0);
    for (row, (state, agent)) in rows.chunks_exact(width.max(1)).zip(teams.agents()) {
        out[(state * windows.shape.agents + agent) * width..][..width].copy_from_slice(row);
    }
}
