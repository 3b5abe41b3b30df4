//! What every environment offers: the seam between simulators and learners.

use alloc::vec;
use alloc::vec::Vec;
use core::fmt;

/// Padded sizes of an environment, constant for its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Agents A.
    pub agents: usize,
    /// Entities N, agents included; at most 128.
    pub entities: usize,
    /// Subtasks T; at most 32.
    pub tasks: usize,
    /// Actions U of one agent.
    pub actions: usize,
    /// Features d of one entity, without its last action.
    pub features: usize,
}

/// Buffers that one instance writes its observation into.
///
/// Entity sets are bit masks: bit e stands for entity e. Task sets likewise.
#[derive(Debug)]
pub struct ObservationMut<'a> {
    /// Features `[N, stride]`; the first d columns of every row are written, absent rows as zeros.
    pub rows: &'a mut [f32],
    /// Columns of a row, d or more.
    pub stride: usize,
    /// The entities that exist.
    pub present: &'a mut u128,
    /// `[A]`: the entities that each agent can observe; empty for absent agents.
    pub observable: &'a mut [u128],
    /// `[N]`: the tasks that each entity belongs to. Agents' entries are the caller's and stay as they are.
    pub entity_task: &'a mut [u32],
    /// `[A, U]`: 0 = not available, 1 = available, 2 + t = available and applies to task t.
    pub available: &'a mut [u16],
    /// The tasks that exist and are not finished.
    pub open_tasks: &'a mut u32,
}

/// An owned set of observation buffers for one instance.
#[derive(Clone, Debug)]
pub struct ObservationBuffers {
    /// Features `[N, stride]`.
    pub rows: Vec<f32>,
    /// Columns of a row.
    pub stride: usize,
    /// The entities that exist.
    pub present: u128,
    /// `[A]`: what each agent can observe.
    pub observable: Vec<u128>,
    /// `[N]`: the tasks that each entity belongs to.
    pub entity_task: Vec<u32>,
    /// `[A, U]`: availability codes.
    pub available: Vec<u16>,
    /// The unfinished tasks.
    pub open_tasks: u32,
}

impl ObservationBuffers {
    /// Buffers without room for last actions: the stride is d.
    pub fn new(shape: &Shape) -> Self {
        Self::with_stride(shape, shape.features)
    }

    /// Buffers whose rows have `stride` columns, at least d.
    pub fn with_stride(shape: &Shape, stride: usize) -> Self {
        let stride = stride.max(shape.features);
        Self {
            rows: vec![0.0; shape.entities * stride],
            stride,
            present: 0,
            observable: vec![0; shape.agents],
            entity_task: vec![0; shape.entities],
            available: vec![0; shape.agents * shape.actions],
            open_tasks: 0,
        }
    }

    /// Lends all buffers to [`Environment::observe`].
    pub fn lend(&mut self) -> ObservationMut<'_> {
        ObservationMut {
            rows: &mut self.rows,
            stride: self.stride,
            present: &mut self.present,
            observable: &mut self.observable,
            entity_task: &mut self.entity_task,
            available: &mut self.available,
            open_tasks: &mut self.open_tasks,
        }
    }
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepOutcome {
    /// The reward that the whole team shares.
    pub reward: f64,
    /// The episode came to its own end: the next state is worth nothing.
    pub terminated: bool,
    /// The time ran out: a learner bootstraps from the next state.
    pub timed_out: bool,
    /// The set of unfinished tasks changed, so that agents are to be allocated anew.
    pub tasks_changed: bool,
}

impl StepOutcome {
    /// Whether the episode is over.
    pub fn done(&self) -> bool {
        self.terminated || self.timed_out
    }
}

/// A step was refused; the instance is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StepError {
    /// The action is not available to this agent, or does not exist.
    Unavailable {
        /// The agent.
        agent: usize,
        /// Its action.
        action: u16,
    },
    /// Fewer actions than agents were given.
    TooFewActions {
        /// The agents of the instance.
        agents: usize,
        /// The actions given.
        actions: usize,
    },
    /// The episode is over: reset the instance first.
    EpisodeOver,
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unavailable { agent, action } => {
                write!(f, "action {action} is not available to agent {agent}")
            }
            Self::TooFewActions { agents, actions } => {
                write!(f, "{actions} actions were given for {agents} agents")
            }
            Self::EpisodeOver => f.write_str("the episode is over; reset the instance first"),
        }
    }
}

impl core::error::Error for StepError {}

/// Many instances of one environment.
///
/// An instance index beyond [`Environment::instances`] is the caller's mistake and panics, as does a
/// buffer shorter than the [`Shape`] says.
pub trait Environment {
    /// The padded sizes.
    fn shape(&self) -> Shape;

    /// How many instances this object holds.
    fn instances(&self) -> usize;

    /// Restarts the generator of one instance. The running episode goes on.
    fn seed(&mut self, instance: usize, seed: u64);

    /// Starts a new episode, drawn from the instance's generator.
    fn reset(&mut self, instance: usize);

    /// Applies one action per present agent; further entries are ignored.
    fn step(&mut self, instance: usize, actions: &[u16]) -> Result<StepOutcome, StepError>;

    /// Writes what there is to see.
    fn observe(&self, instance: usize, observation: &mut ObservationMut<'_>);

    /// The agents that exist in the running episode; they are the first entities.
    fn agent_count(&self, instance: usize) -> usize;

    /// Whether the episode is over and the instance waits for a reset.
    fn is_done(&self, instance: usize) -> bool;

    /// Steps every instance with `actions` `[I, A]`, writing `outcomes` `[I]`.
    ///
    /// Stops at the first refusal and says which instance refused; those before it have stepped.
    fn step_all(
        &mut self,
        actions: &[u16],
        outcomes: &mut [StepOutcome],
    ) -> Result<(), (usize, StepError)> {
        let agents = self.shape().agents;
        for (instance, outcome) in outcomes.iter_mut().enumerate().take(self.instances()) {
            let own = &actions[instance * agents..][..agents];
            *outcome = self.step(instance, own).map_err(|error| (instance, error))?;
        }
        Ok(())
    }
}

/// An environment whose task decomposes into subtasks (dissertation section 7.2).
pub trait Subtasks: Environment {
    /// The tasks that exist and are not finished, as bits.
    fn open_tasks(&self, instance: usize) -> u32;

    /// The rewards `[T]` of the last step, one per task; zeros after a reset.
    fn task_rewards(&self, instance: usize) -> &[f64];

    /// The tasks, as bits, that an entity belongs to by itself; none for agents and absent entities.
    fn entity_task(&self, instance: usize, entity: usize) -> u32;
}
