//! What every environment offers to learners.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;
use core::any::Any;
use core::fmt;

use crate::frame::Frame;
use crate::observation::{AgentSet, EntitySet, Observation, TaskSet, members};
use crate::picture::Picture;
use crate::random::Random;
use crate::rows::SparseRows;
use crate::spec::Spec;

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// The reward that the whole team shares.
    pub reward: f64,
    /// The episode came to its own end: the next state is worth nothing.
    pub terminated: bool,
    /// The time ran out: a learner bootstraps from the next state.
    pub timed_out: bool,
    /// The set of unfinished tasks changed, so that agents are to be allocated anew.
    pub tasks_changed: bool,
}

impl Step {
    /// Whether the episode is over.
    pub fn done(&self) -> bool {
        self.terminated || self.timed_out
    }
}

/// What an episode has come to; final once it is over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// Steps so far.
    pub steps: u32,
    /// Whether it is over.
    pub done: bool,
    /// Whether the task is fulfilled.
    pub solved: bool,
    /// Whether the time ran out.
    pub timed_out: bool,
    /// Sum of the team's rewards.
    pub episode_return: f64,
    /// What kind of episode it is, for tables by kind; such as the team's letters.
    pub group: String,
    /// Values of the [metrics](Spec::metrics) in their order; none where the episode has no such value.
    pub metrics: Vec<Option<f64>>,
    /// Why it failed, one of the [causes](Spec::causes); none where that is not known, or it did not fail.
    pub cause: Option<&'static str>,
}

/// Which starts are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Split {
    /// Those to learn from.
    #[default]
    Train,
    /// Those to measure on. Environments without a list of their own draw from the same starts.
    Test,
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

/// The actions of so many agents, each one of so many that are always possible, in an episode that runs.
pub(crate) fn checked_actions(
    is_done: bool,
    agents: usize,
    known: usize,
    actions: &[u16],
) -> Result<&[u16], StepError> {
    if is_done {
        return Err(StepError::EpisodeOver);
    }
    let too_few = StepError::TooFewActions { agents, actions: actions.len() };
    let actions = actions.get(..agents).ok_or(too_few)?;
    match actions.iter().position(|action| usize::from(*action) >= known) {
        Some(agent) => Err(StepError::Unavailable { agent, action: actions[agent] }),
        None => Ok(actions),
    }
}

/// Bytes are no state of this environment; the instance is as it was.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StateError {
    /// The bytes are of another version of the state's layout.
    Version {
        /// The version that the bytes carry.
        found: u8,
        /// The version that is read.
        wanted: u8,
    },
    /// There are too few or too many bytes.
    Length {
        /// The bytes given.
        found: usize,
        /// The bytes that such a state has.
        wanted: usize,
    },
    /// No episode can be in this state.
    Impossible(String),
}

impl fmt::Display for StateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version { found, wanted } => {
                write!(f, "a state of layout {found}; this build reads layout {wanted}")
            }
            Self::Length { found, wanted } => {
                write!(f, "a state of {found} bytes; it should have {wanted}")
            }
            Self::Impossible(reason) => write!(f, "no episode can be in this state: {reason}"),
        }
    }
}

impl core::error::Error for StateError {}

/// Many instances of one environment.
///
/// A *state* is all that an episode needs to go on, as bytes: [`save`](Self::save) writes it,
/// [`load`](Self::load) continues from it, and [`observe`](Self::observe) and all that follow see nothing else.
/// So a learner keeps states and rebuilds what was seen. Every random choice comes from the generator that is
/// passed in: the same state, actions and generator give the same step.
///
/// Learners observe from several threads at once. [`conformance::check`](crate::conformance::check) tests what is promised here. An instance beyond
/// [`instances`](Self::instances) and bytes that [`load`](Self::load) refuses are the caller's mistake and panic.
pub trait Environment: Any + Send + Sync {
    /// What this environment says of itself.
    fn spec(&self) -> &Spec;

    /// How many instances this object holds.
    fn instances(&self) -> usize;

    /// The same environment with instances of its own, that draw from other starts. Their episodes are over.
    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment>;

    /// Starts a new episode.
    fn reset(&mut self, instance: usize, random: &mut Random);

    /// Applies one action per existing agent; further entries are ignored.
    ///
    /// # Errors
    /// An action is missing or not available, or the episode is over; nothing has changed then.
    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError>;

    /// Notes `[A]` what the agents act for in the next step of an instance, before every step from the first on, by
    /// which [`Episode::cause`] is told. It changes nothing else.
    fn note_allocation(&mut self, instance: usize, allocation: &[u8]) {
        let _ = (instance, allocation);
    }

    /// `[T]`: what each subtask earned in the last step; empty where [`Spec::rewards`] has none.
    fn task_rewards(&self, instance: usize) -> &[f64] {
        let _ = instance;
        &[]
    }

    /// `[A]`: what each agent earned in the last step; empty where [`Spec::rewards`] has none.
    fn agent_rewards(&self, instance: usize) -> &[f64] {
        let _ = instance;
        &[]
    }

    /// Appends the state, at most [`Spec::state_bytes`].
    fn save(&self, instance: usize, state: &mut Vec<u8>);

    /// Continues from a state.
    ///
    /// # Errors
    /// The bytes are no state of this environment.
    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError>;

    /// Writes what there is to see in a state under a symmetry: masks and subtasks of all, rows of the `wanted`
    /// entities that exist. Turn 0 changes nothing.
    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation);

    /// What a state looks like, for whoever shows it: without a picture of its own what is observed of each entity.
    fn picture(&self, state: &[u8]) -> Picture {
        let mut seen = Observation::default();
        self.observe(state, 0, EntitySet::MAX, &mut seen);
        Picture::of_observation(self.spec(), &seen)
    }

    /// Puts an entity elsewhere between two steps: agents come first, things behind them. A place is one of the
    /// [`picture`](Self::picture).
    ///
    /// # Errors
    /// It cannot be there; nothing has changed then.
    fn place(&mut self, instance: usize, entity: usize, place: [f64; 2]) -> Result<(), StateError> {
        let _ = (instance, entity, place);
        Err(StateError::Impossible("nothing here can be put elsewhere".into()))
    }

    /// Does to a thing, by its number behind the agents, what may come about by chance as well.
    ///
    /// # Errors
    /// Nothing comes of it; nothing has changed then.
    fn disturb(&mut self, instance: usize, thing: usize) -> Result<(), StateError> {
        let _ = (instance, thing);
        Err(StateError::Impossible("nothing can happen to it".into()))
    }

    /// What the running or last episode has come to.
    fn episode(&self, instance: usize) -> Episode;

    /// The number that an action has under a symmetry.
    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        let _ = turn;
        action
    }

    /// The subtask that an action of an agent applies to, if it applies to one alone.
    fn subtask_of(&self, state: &[u8], agent: usize, action: u16) -> Option<usize> {
        let _ = (state, agent, action);
        None
    }

    /// Writes `[A]` the open subtasks that each agent can be given, as bits, nothing for those that do not act; returns those
    /// that one agent alone can have. Unless an environment knows more, everybody can have all.
    fn offers(&self, state: &[u8], offers: &mut Vec<TaskSet>) -> TaskSet {
        let mut seen = Observation::default();
        self.observe(state, 0, 0, &mut seen);
        let offer = |agent| if seen.acting() >> agent & 1 == 1 { seen.open_tasks } else { 0 };
        offers.clear();
        offers.extend((0..seen.observable.len()).map(offer));
        0
    }

    /// Assigns every agent a subtask by one of the [rules](Spec::rules); `None` (255) for nobody and nothing.
    fn allocate(&self, rule: usize, state: &[u8], random: &mut Random, allocation: &mut [u8]) {
        let _ = (rule, state, random);
        allocation.fill(u8::MAX);
    }

    /// Writes scripted actions under an allocation; false where there is no script.
    fn scripted(
        &self,
        state: &[u8],
        allocation: &[u8],
        random: &mut Random,
        actions: &mut [u16],
    ) -> bool {
        let _ = (state, allocation, random, actions);
        false
    }

    /// How near a team is to its subtask, or without one to any, as shaping takes it (Ng, Harada and Russell 1999):
    /// `-scale` for each step that is missing.
    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, task: Option<usize>) -> f32 {
        let _ = (state, scale, team, task);
        0.0
    }

    /// Writes `[A]` the [`potential`](Self::potential) of each agent alone, without a subtask.
    fn potentials(&self, state: &[u8], scale: f32, potentials: &mut [f32]) {
        for (agent, potential) in potentials.iter_mut().enumerate() {
            *potential = self.potential(state, scale, 1 << agent, None);
        }
    }

    /// A state as the rows of a frame show it, from which an episode can be played on; what it came to before is lost. None
    /// where rows do not tell.
    ///
    /// Whoever sees messages alone looks ahead from it.
    fn rebuilt(&self, frame: &Frame<'_>) -> Option<Vec<u8>> {
        let _ = frame;
        None
    }

    /// Writes for each of the `wanted` entities that exist how it stands to a subtask, a row of
    /// [`Spec::relations`] columns each; empty rows where there are none, and of the subtask's first thing, which asks.
    fn relate(
        &self,
        state: &[u8],
        turn: usize,
        task: usize,
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        let _ = task;
        let mut seen = Observation::default();
        self.observe(state, turn, 0, &mut seen);
        members(wanted & seen.present).for_each(|_| rows.end_row());
    }

    /// The [milestone](Spec::milestones) that the last step of an instance reached, by its number.
    fn milestone(&self, instance: usize) -> Option<usize> {
        let _ = instance;
        None
    }

    /// The milestones, as bits, of which each can be reached next without another one before (the hierarchical
    /// affordances of HAL), which agents do not see and oracle masks show; none where there is no such truth.
    fn affordances(&self, state: &[u8]) -> Option<u32> {
        let _ = state;
        None
    }

    /// Writes `[A]` the entities that truly belong with each agent, itself among them: what oracle masks of REFIL show,
    /// and what attention is measured by; false where there is no such truth.
    fn companions(&self, state: &[u8], companions: &mut [EntitySet]) -> bool {
        let _ = (state, companions);
        false
    }
}
