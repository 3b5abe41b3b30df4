//! What a robot and whoever serves its policy say to each other: an observation, and its answer.
//!
//! One piece of bytes each, the head first: they are the same in shared memory and over a socket.

use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use super::{ABI, assert_layout};
use crate::limits;
use crate::plan::Trip;
use crate::policy::DecideError;

/// Head of an observation. The inputs follow as f32, one behind the other, then the availability mask as u16.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct ObservationHead {
    /// [`ObservationHead::MAGIC`].
    pub magic: u32,
    /// [`ABI`].
    pub abi: u16,
    /// Always 0.
    pub unused: u16,
    /// Hash of what the policy takes and gives.
    pub schema: u64,
    /// Whose observation it is: a number that no two clients have.
    pub session: u64,
    /// One more with every observation of a session, from 1.
    pub seq: u64,
    /// Time of sending, in nanoseconds of the host's clock.
    pub t_ns: u64,
    /// Time until which an answer counts.
    pub deadline_ns: u64,
    /// Episode of the session: with another one the recurrent state starts anew.
    pub episode: u32,
    /// Numbers of all inputs.
    pub inputs: u32,
    /// Actions U that the mask is about; 0 where the policy does not choose among actions.
    pub actions: u32,
    /// Always 0.
    pub unused_word: u32,
}

assert_layout!(ObservationHead, 64, {
    magic: 0, abi: 4, unused: 6, schema: 8, session: 16, seq: 24, t_ns: 32, deadline_ns: 40,
    episode: 48, inputs: 52, actions: 56, unused_word: 60,
});

/// Head of an answer. The outputs follow as f32, one behind the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct AnswerHead {
    /// [`AnswerHead::MAGIC`].
    pub magic: u32,
    /// [`ABI`].
    pub abi: u16,
    /// A set of the flags named below.
    pub flags: u16,
    /// Hash of what the policy takes and gives.
    pub schema: u64,
    /// The session that is answered.
    pub session: u64,
    /// The observation that is answered.
    pub seq: u64,
    /// Time of sending, in nanoseconds of the host's clock.
    pub t_ns: u64,
    /// Time of the decision alone, in nanoseconds.
    pub decide_ns: u32,
    /// The action, or -1 where the policy does not choose or none is available.
    pub action: i32,
    /// An [`AnswerStatus`].
    pub status: u16,
    /// A [`Reason`].
    pub reason: u16,
    /// Numbers of all outputs.
    pub outputs: u32,
    /// The server: its process id.
    pub server: u32,
    /// The number of the [`Trip`] that a guard of the plan made, or 0.
    pub guard: u32,
}

assert_layout!(AnswerHead, 64, {
    magic: 0, abi: 4, flags: 6, schema: 8, session: 16, seq: 24, t_ns: 32, decide_ns: 40,
    action: 44, status: 48, reason: 50, outputs: 52, server: 56, guard: 60,
});

/// What became of an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum AnswerStatus {
    /// The policy has answered in time.
    Answered = 0,
    /// The policy has answered, after the deadline.
    Late = 1,
    /// The observation is not of this policy; there is no action.
    Refused = 2,
    /// The policy has not answered; this is the fallback.
    Fallback = 3,
}

impl AnswerStatus {
    /// The status of this number, if there is one.
    pub fn from_number(number: u16) -> Option<Self> {
        let all = [Self::Answered, Self::Late, Self::Refused, Self::Fallback];
        all.into_iter().find(|status| *status as u16 == number)
    }
}

/// Why a policy has not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Reason {
    /// It has.
    None = 0,
    /// The observation is of another schema or ABI.
    Foreign = 1,
    /// Its lengths are not the policy's.
    Length = 2,
    /// An input, an output or a state is no finite number.
    NonFinite = 3,
    /// No action is available.
    NoAvailableAction = 4,
    /// The plan cannot decide on such observations.
    Policy = 5,
    /// No answer came before the deadline. Only a client says so.
    Silence = 6,
    /// A guard of the plan tripped, or one that did is held: the head says which.
    Guard = 7,
}

impl Reason {
    /// The reason of this number, if there is one.
    pub fn from_number(number: u16) -> Option<Self> {
        let all = [
            Self::None,
            Self::Foreign,
            Self::Length,
            Self::NonFinite,
            Self::NoAvailableAction,
            Self::Policy,
            Self::Silence,
            Self::Guard,
        ];
        all.into_iter().find(|reason| *reason as u16 == number)
    }
}

impl From<DecideError> for Reason {
    fn from(error: DecideError) -> Self {
        match error {
            DecideError::NonFinite => Self::NonFinite,
            DecideError::NoAvailableAction => Self::NoAvailableAction,
            DecideError::BadLength => Self::Length,
            _ => Self::Policy,
        }
    }
}

impl From<MessageError> for Reason {
    fn from(error: MessageError) -> Self {
        match error {
            MessageError::Foreign => Self::Foreign,
            MessageError::Length => Self::Length,
        }
    }
}

/// Why a message is not read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MessageError {
    /// Magic, ABI or schema are not this policy's.
    Foreign,
    /// The bytes, or their alignment, or the numbers in them are not as many as the policy's.
    Length,
}

impl core::fmt::Display for MessageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Foreign => "the message is of another policy or ABI",
            Self::Length => "the message has another length than the policy's",
        })
    }
}

impl core::error::Error for MessageError {}

impl ObservationHead {
    /// "SOBS" in the first bytes.
    pub const MAGIC: u32 = 0x5342_4F53;

    /// The head of bytes that may be an observation of any policy, for an answer that refuses it.
    pub fn of(bytes: &[u8]) -> Option<&Self> {
        let (head, _) = Self::ref_from_prefix(bytes).ok()?;
        (head.magic == Self::MAGIC && head.abi == ABI).then_some(head)
    }
}

impl AnswerHead {
    /// "SACT" in the first bytes.
    pub const MAGIC: u32 = 0x5443_4153;

    /// Recurrent state was cleared before this decision.
    pub const STATE_RESET: u16 = 1;
    /// Observations were missed since the last answer.
    pub const GAP: u16 = 2;
    /// Outputs beyond their limits were brought back to them, first by the guard that `guard` names.
    pub const CLAMPED: u16 = 4;

    /// Whether all flags of `flags` are set.
    pub fn has(&self, flags: u16) -> bool {
        self.flags & flags == flags
    }

    /// Which guard of the plan tripped.
    pub fn trip(&self) -> Option<Trip> {
        Trip::from_number(self.guard)
    }
}

/// The sizes of one policy's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServedFormat {
    schema: u64,
    inputs: u32,
    outputs: u32,
    actions: u32,
}

impl ServedFormat {
    /// Bytes of both heads.
    const HEAD: usize = size_of::<ObservationHead>();

    /// Messages of a policy with so many numbers in all inputs and in all outputs, which chooses one of `actions`;
    /// 0 = it does not choose.
    ///
    /// # Errors
    /// `Length` where a message is longer than [`limits::FRAME_BYTES`], or there are too many actions.
    pub fn new(
        schema: u64,
        inputs: usize,
        outputs: usize,
        actions: usize,
    ) -> Result<Self, MessageError> {
        let most = (limits::FRAME_BYTES - Self::HEAD) / 4 - limits::ACTIONS;
        if inputs > most || outputs > most || actions > limits::ACTIONS {
            return Err(MessageError::Length);
        }
        // All fit: the limits do.
        let [inputs, outputs, actions] = [inputs, outputs, actions].map(|count| count as u32);
        Ok(Self { schema, inputs, outputs, actions })
    }

    /// Hash of what the policy takes and gives.
    pub fn schema(&self) -> u64 {
        self.schema
    }

    /// Numbers of all inputs.
    pub fn inputs(&self) -> usize {
        self.inputs as usize
    }

    /// Numbers of all outputs.
    pub fn outputs(&self) -> usize {
        self.outputs as usize
    }

    /// Actions U, 0 where the policy does not choose.
    pub fn actions(&self) -> usize {
        self.actions as usize
    }

    /// Bytes of an observation, a multiple of 4.
    pub fn observation_bytes(&self) -> usize {
        Self::HEAD + 4 * self.inputs() + 4 * self.actions().div_ceil(2)
    }

    /// Bytes of an answer.
    pub fn answer_bytes(&self) -> usize {
        Self::HEAD + 4 * self.outputs()
    }

    /// Writes an observation with the schema and the counts of this format.
    ///
    /// # Errors
    /// `Length` where `to` or what is to be written is not as long as the format says.
    pub fn write_observation(
        &self,
        head: &ObservationHead,
        inputs: &[&[f32]],
        available: &[u16],
        to: &mut [u8],
    ) -> Result<(), MessageError> {
        let Self { schema, inputs: count, actions, .. } = *self;
        let given = inputs.iter().map(|input| input.len()).sum::<usize>();
        let fits = given == self.inputs() && available.len() == self.actions();
        if !fits || to.len() != self.observation_bytes() {
            return Err(MessageError::Length);
        }
        let (magic, abi) = (ObservationHead::MAGIC, ABI);
        let head = ObservationHead { magic, abi, schema, inputs: count, actions, ..*head };
        let mut to = Bytes(to);
        to.put(head.as_bytes())?;
        inputs.iter().try_for_each(|input| to.put(input.as_bytes()))?;
        to.put(available.as_bytes())?;
        to.0.fill(0);
        Ok(())
    }

    /// Reads an observation in place.
    ///
    /// # Errors
    /// See [`MessageError`].
    pub fn read_observation<'a>(
        &self,
        bytes: &'a [u8],
    ) -> Result<ObservationView<'a>, MessageError> {
        let (head, rest) =
            ObservationHead::ref_from_prefix(bytes).map_err(|_| MessageError::Length)?;
        let ours = (ObservationHead::MAGIC, ABI, self.schema);
        if (head.magic, head.abi, head.schema) != ours {
            return Err(MessageError::Foreign);
        }
        let counts = (head.inputs, head.actions) == (self.inputs, self.actions);
        if !counts || bytes.len() != self.observation_bytes() {
            return Err(MessageError::Length);
        }
        let (inputs, rest) = <[f32]>::ref_from_prefix_with_elems(rest, self.inputs())
            .map_err(|_| MessageError::Length)?;
        let (available, _) = <[u16]>::ref_from_prefix_with_elems(rest, self.actions())
            .map_err(|_| MessageError::Length)?;
        Ok(ObservationView { head, inputs, available })
    }

    /// Writes an answer with the schema and the count of this format.
    ///
    /// # Errors
    /// `Length` where `to` or the outputs are not as long as the format says.
    pub fn write_answer(
        &self,
        head: &AnswerHead,
        outputs: &[f32],
        to: &mut [u8],
    ) -> Result<(), MessageError> {
        if outputs.len() != self.outputs() || to.len() != self.answer_bytes() {
            return Err(MessageError::Length);
        }
        let Self { schema, outputs: count, .. } = *self;
        let (magic, abi) = (AnswerHead::MAGIC, ABI);
        let head = AnswerHead { magic, abi, schema, outputs: count, ..*head };
        let mut to = Bytes(to);
        to.put(head.as_bytes())?;
        to.put(outputs.as_bytes())
    }

    /// Reads an answer in place.
    ///
    /// # Errors
    /// See [`MessageError`].
    pub fn read_answer<'a>(&self, bytes: &'a [u8]) -> Result<AnswerView<'a>, MessageError> {
        let (head, rest) = AnswerHead::ref_from_prefix(bytes).map_err(|_| MessageError::Length)?;
        let ours = (AnswerHead::MAGIC, ABI, self.schema);
        if (head.magic, head.abi, head.schema) != ours {
            return Err(MessageError::Foreign);
        }
        if head.outputs != self.outputs || bytes.len() != self.answer_bytes() {
            return Err(MessageError::Length);
        }
        let outputs = <[f32]>::ref_from_bytes(rest).map_err(|_| MessageError::Length)?;
        Ok(AnswerView { head, outputs })
    }
}

/// A checked observation, read in place.
#[derive(Clone, Copy, Debug)]
pub struct ObservationView<'a> {
    /// The head.
    pub head: &'a ObservationHead,
    /// All inputs, one behind the other.
    pub inputs: &'a [f32],
    /// Availability of actions `[U]`, 0 = not available; empty where the policy does not choose.
    pub available: &'a [u16],
}

/// A checked answer, read in place.
#[derive(Clone, Copy, Debug)]
pub struct AnswerView<'a> {
    /// The head.
    pub head: &'a AnswerHead,
    /// All outputs, one behind the other.
    pub outputs: &'a [f32],
}

impl Default for ObservationHead {
    fn default() -> Self {
        Self::new_zeroed()
    }
}

impl Default for AnswerHead {
    fn default() -> Self {
        Self::new_zeroed()
    }
}

/// Bytes that are written from their beginning on.
struct Bytes<'a>(&'a mut [u8]);

impl Bytes<'_> {
    fn put(&mut self, from: &[u8]) -> Result<(), MessageError> {
        let to = self.0.split_off_mut(..from.len()).ok_or(MessageError::Length)?;
        to.copy_from_slice(from);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
