//! What an agent sees and how it decides: the seam between messages and networks.

use crate::entity_mask::EntityMask;

/// Marks "no action yet" among last actions, and "does not act" in an action message.
pub const NO_ACTION: u16 = 0xFFFF;

/// What one agent sees in one step. N entities, of which the first A are agents; d features; U actions.
///
/// The network's input has d + U columns: the last action's one-hot is implied, never materialised.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Features `[N, stride]`; the first d columns of a row count.
    pub rows: &'a [f32],
    /// Columns of a row, d or more.
    pub stride: usize,
    /// Last action `[A]` of every agent, [`NO_ACTION`] where there was none.
    pub last_actions: &'a [u16],
    /// The entities that this agent may attend to (see [`visible`]).
    pub visible: EntityMask,
    /// This agent's own row, which forms the query even where it is not visible.
    pub self_index: usize,
    /// Availability mask `[U]`: 0 = not available.
    pub available: &'a [u16],
}

/// The chosen action and its utility.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Decision {
    /// Index of the action.
    pub action: u16,
    /// The network's utility of that action.
    pub utility: f32,
}

/// Why no decision could be taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecideError {
    /// More entities are visible than the plan was sized for.
    TooManyEntities {
        /// The plan's limit.
        max: usize,
        /// The entities seen.
        got: usize,
    },
    /// A slice of the observation, of the utilities or of the arena has the wrong length.
    BadLength,
    /// No action is available.
    NoAvailableAction,
    /// A visible feature, or a utility, is not a finite number.
    NonFinite,
    /// The recurrent state that was given is not of the policy's size.
    HiddenState {
        /// Floats of the policy's state, 0 where it has none.
        want: usize,
        /// Floats given.
        got: usize,
    },
    /// The team's policies are for other agents.
    UnknownAgent {
        /// Agents that have a policy.
        agents: usize,
        /// The one that observes.
        agent: usize,
    },
    /// The policy chooses greedily: its utilities are not logits to draw from.
    Greedy,
    /// A number that should be that of a table's row is none.
    NoSuchRow {
        /// The table's rows.
        rows: usize,
    },
    /// A feature lies outside of the range that it is guarded by, or is NaN.
    BeyondGuards {
        /// Whose: the row of the observation.
        entity: usize,
        /// Which column of it.
        feature: usize,
    },
}

impl core::fmt::Display for DecideError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooManyEntities { max, got } => {
                write!(f, "{got} entities are visible, the policy takes at most {max}")
            }
            Self::BadLength => f.write_str("a part of the observation has the wrong length"),
            Self::NoAvailableAction => f.write_str("no action is available"),
            Self::NonFinite => f.write_str("a feature or a utility is not a finite number"),
            Self::HiddenState { want, got } => {
                write!(f, "the policy's recurrent state has {want} numbers, {got} were given")
            }
            Self::UnknownAgent { agents, agent } => {
                write!(f, "agent {agent} has no policy: there are policies for {agents} agents")
            }
            Self::Greedy => f.write_str("the policy chooses greedily and cannot be drawn from"),
            Self::NoSuchRow { rows } => {
                write!(f, "a number chooses a row of a table of {rows}, and there is no such row")
            }
            Self::BeyondGuards { entity, feature } => {
                write!(f, "feature {feature} of entity {entity} lies outside of its guarded range")
            }
        }
    }
}

impl core::error::Error for DecideError {}

/// A deployed utility network of one agent.
pub trait Policy {
    /// Number of actions U.
    fn actions(&self) -> usize;

    /// Writes the utilities `[U]`, not masked by availability.
    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError>;

    /// Greedy choice among the available actions, lowest index on ties.
    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError>;

    /// Decides for several agents, each as [`Self::decide`] does. Agents of one frame, whose observations have
    /// the same rows and last actions, are cheaper together. Answers beyond the shorter of the two slices are
    /// not given.
    fn decide_batch(
        &mut self,
        observations: &[Observation<'_>],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        for (observation, decision) in observations.iter().zip(decisions) {
            *decision = self.decide(observation);
        }
    }

    /// As [`Self::decide_batch`] of a policy with memory. `hidden` `[B, R]` holds the states of those that observe, in the
    /// same order, each as in [`Self::decide_with`]; a state of another size answers everyone with
    /// [`DecideError::HiddenState`].
    fn decide_batch_with(
        &mut self,
        observations: &[Observation<'_>],
        hidden: &mut [f32],
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        let size = self.hidden();
        let (want, got) = (observations.len().saturating_mul(size), hidden.len());
        if got != want {
            return decisions.fill(Err(DecideError::HiddenState { want, got }));
        }
        for (index, (observation, decision)) in observations.iter().zip(decisions).enumerate() {
            let start = index.saturating_mul(size);
            let state = hidden.get_mut(start..start.saturating_add(size)).unwrap_or_default();
            *decision = self.decide_with(observation, state);
        }
    }

    /// Brings what the next decision reads near, ahead of a deadline; changes nothing else.
    fn warm(&self) {}

    /// Forgets all earlier decisions: an episode begins. Returns whether there is memory to be cleared.
    fn begin_episode(&mut self) -> bool {
        false
    }

    /// Floats R of the recurrent state, 0 for a policy without memory.
    fn hidden(&self) -> usize {
        0
    }

    /// As [`Self::utilities`] of a policy with memory. `hidden` `[R]` is this agent's state, which the caller
    /// keeps and sets to zero where an episode begins; it is replaced if the utilities could be computed.
    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        no_memory(hidden)?;
        self.utilities(observation, utilities)
    }

    /// As [`Self::decide`] of a policy with memory, see [`Self::utilities_with`].
    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        no_memory(hidden)?;
        self.decide(observation)
    }
}

fn no_memory(hidden: &[f32]) -> Result<(), DecideError> {
    match hidden.len() {
        0 => Ok(()),
        got => Err(DecideError::HiddenState { want: 0, got }),
    }
}

/// What points to a policy is one.
macro_rules! policy_behind {
    ($pointer:ty) => {
        impl<P: Policy + ?Sized> Policy for $pointer {
            fn actions(&self) -> usize {
                (**self).actions()
            }

            fn utilities(
                &mut self,
                observation: &Observation<'_>,
                utilities: &mut [f32],
            ) -> Result<(), DecideError> {
                (**self).utilities(observation, utilities)
            }

            fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
                (**self).decide(observation)
            }

            fn decide_batch(
                &mut self,
                observations: &[Observation<'_>],
                decisions: &mut [Result<Decision, DecideError>],
            ) {
                (**self).decide_batch(observations, decisions);
            }

            fn decide_batch_with(
                &mut self,
                observations: &[Observation<'_>],
                hidden: &mut [f32],
                decisions: &mut [Result<Decision, DecideError>],
            ) {
                (**self).decide_batch_with(observations, hidden, decisions);
            }

            fn warm(&self) {
                (**self).warm();
            }

            fn begin_episode(&mut self) -> bool {
                (**self).begin_episode()
            }

            fn hidden(&self) -> usize {
                (**self).hidden()
            }

            fn utilities_with(
                &mut self,
                observation: &Observation<'_>,
                hidden: &mut [f32],
                utilities: &mut [f32],
            ) -> Result<(), DecideError> {
                (**self).utilities_with(observation, hidden, utilities)
            }

            fn decide_with(
                &mut self,
                observation: &Observation<'_>,
                hidden: &mut [f32],
            ) -> Result<Decision, DecideError> {
                (**self).decide_with(observation, hidden)
            }
        }
    };
}

policy_behind!(&mut P);
#[cfg(feature = "std")]
policy_behind!(std::boxed::Box<P>);

/// The entities that an agent of `subtask` may attend to: observable, present, and of the same subtask.
///
/// `entity_task[e]` has bit t set where entity e belongs to subtask t (dissertation section 7.3).
/// An agent without a subtask belongs to no group and sees nothing. Pass the intersection of
/// `observable` and `present` instead where the policy is not subtask-conditioned.
pub fn visible(
    observable: EntityMask,
    present: EntityMask,
    entity_task: &[u32],
    subtask: Option<u8>,
) -> EntityMask {
    let bit = subtask.and_then(|task| 1u32.checked_shl(u32::from(task))).unwrap_or(0);
    let mut mask = observable.and(&present);
    for (entity, tasks) in entity_task.iter().enumerate() {
        if tasks & bit == 0 {
            mask.remove(entity);
        }
    }
    mask
}
