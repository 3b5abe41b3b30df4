//! A policy as one node: it reads what a robot observes, and publishes what the robot is to do.
//!
//! | topic | messages | |
//! | --- | --- | --- |
//! | `observation` | [`Float32MultiArray`] | read: the numbers of all inputs, one behind the other |
//! | `reset` | [`Empty`] | read: the next observation begins an episode |
//! | `action` | [`Float32MultiArray`] | the numbers of all outputs, one behind the other |
//! | `action` | [`Int32`] | instead, where the policy chooses among actions |
//! | `joint_command` | [`JointState`] | besides, where the policy names the joints of its outputs |

use crate::attachment::{Attachment, AttachmentError};
use crate::cdr::{CdrError, decode};
use crate::messages::{
    Empty, Float32MultiArray, Header, Int32, JointState, MultiArrayDimension, MultiArrayLayout,
    Time,
};
use crate::node::{BridgeError, Carrier, Node, Publisher};
use crate::qos::Qos;

/// Why an observation is none of this policy's.
#[derive(Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ObservationError {
    /// Its bytes are no message.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// What goes with it is no attachment.
    #[error(transparent)]
    Attachment(#[from] AttachmentError),
    /// Other numbers than the policy takes.
    #[error("it has {got} numbers; the policy takes {want}: {inputs}")]
    Length {
        /// Those of all inputs.
        want: usize,
        /// Those that came.
        got: usize,
        /// The inputs with their lengths, in their order.
        inputs: String,
    },
    /// A layout that says something else than its numbers.
    #[error(
        "its layout is of {said} numbers behind {offset}, and it has {got}; leave the layout empty"
    )]
    Layout {
        /// The product of its dimensions.
        said: u64,
        /// `data_offset`.
        offset: u32,
        /// Numbers that came.
        got: usize,
    },
}

/// What a policy takes and gives.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PolicyFacts {
    /// Inputs in their order, with their lengths.
    pub inputs: Vec<(String, usize)>,
    /// Outputs in their order, with their lengths.
    pub outputs: Vec<(String, usize)>,
    /// Actions that it chooses among; 0 = its outputs are the action.
    pub actions: usize,
    /// The joints that its first output is for, in its order; none where it does not say.
    pub joints: Vec<String>,
}

impl PolicyFacts {
    fn numbers(&self) -> usize {
        self.inputs.iter().map(|(_, length)| length).sum()
    }

    /// The joints, where each has a number of the first output.
    fn commanded(&self) -> &[String] {
        let first = self.outputs.first().map_or(0, |(_, length)| *length);
        if self.actions == 0 && first == self.joints.len() { &self.joints } else { &[] }
    }
}

/// What a robot observed.
#[derive(Clone, Debug, PartialEq)]
pub struct Observed {
    /// Numbers of all inputs, one behind the other.
    pub numbers: Vec<f32>,
    /// When it was sent, and by whom.
    pub attachment: Attachment,
}

/// A policy's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer<'a> {
    /// The numbers of all outputs, one behind the other.
    Outputs(&'a [f32]),
    /// The action that was chosen.
    Choice(i32),
}

/// A policy behind topics.
#[derive(Debug)]
pub struct PolicyNode<C: Carrier> {
    carrier: C,
    facts: PolicyFacts,
    observation_key: String,
    reset_key: String,
    action: Publisher,
    joint_command: Option<Publisher>,
}

impl<C: Carrier> PolicyNode<C> {
    /// Says that the node is there, reads observations and publishes actions. What comes to [`Self::observation_key`] and
    /// [`Self::reset_key`] its carrier hears, or whoever opens it.
    ///
    /// # Errors
    /// [`BridgeError::Carrier`]; [`BridgeError::Definition`]: with the node's namespace a topic has more than 255 letters.
    pub fn open(
        mut carrier: C,
        node: &Node,
        facts: PolicyFacts,
    ) -> Result<Self, BridgeError<C::Error>> {
        let (observation, observation_key) =
            node.subscription::<Float32MultiArray>(1, "observation", Qos::SENSOR)?;
        let action = match facts.actions {
            0 => node.publisher::<Float32MultiArray>(2, "action", Qos::TOPIC)?,
            _ => node.publisher::<Int32>(2, "action", Qos::TOPIC)?,
        };
        let joint_command = match facts.commanded() {
            [] => None,
            _ => Some(node.publisher::<JointState>(3, "joint_command", Qos::TOPIC)?),
        };
        let (reset, reset_key) = node.subscription::<Empty>(4, "reset", Qos::TOPIC)?;
        let publishers = std::iter::once(&action).chain(&joint_command).map(Publisher::token);
        for token in [node.token(), &observation, &reset].into_iter().chain(publishers) {
            carrier.declare(&token.to_string()).map_err(BridgeError::Carrier)?;
        }
        Ok(Self { carrier, facts, observation_key, reset_key, action, joint_command })
    }

    /// The key of observations.
    pub fn observation_key(&self) -> &str {
        &self.observation_key
    }

    /// The key of resets: whatever comes there begins an episode.
    pub fn reset_key(&self) -> &str {
        &self.reset_key
    }

    /// Reads what came to the key of observations. Whether the numbers are finite is for the policy to say.
    ///
    /// # Errors
    /// See [`ObservationError`]; such an observation is dropped and told of.
    pub fn read(&self, bytes: &[u8], attachment: &[u8]) -> Result<Observed, ObservationError> {
        let attachment = Attachment::from_bytes(attachment)?;
        let Float32MultiArray { layout, data } = decode(bytes)?;
        check_layout(&layout, data.len())?;
        let (want, got) = (self.facts.numbers(), data.len());
        if want != got {
            // Plans may leave their inputs without names.
            let one = |(name, length): &(String, usize)| format!("{name} [{length}]");
            let inputs = self.facts.inputs.iter().map(one);
            let inputs: Vec<_> = inputs.map(|input| input.trim_start().to_owned()).collect();
            return Err(ObservationError::Length { want, got, inputs: inputs.join(", ") });
        }
        Ok(Observed { numbers: data, attachment })
    }

    /// Publishes the answer, with the time since 1970 at which it was given.
    ///
    /// # Errors
    /// [`BridgeError::Carrier`].
    pub fn answer(
        &mut self,
        answer: Answer<'_>,
        source_ns: u64,
    ) -> Result<(), BridgeError<C::Error>> {
        let Self { carrier, facts, action, joint_command, .. } = self;
        let outputs = match answer {
            Answer::Choice(data) => return action.publish(carrier, &Int32 { data }, source_ns),
            Answer::Outputs(outputs) => outputs,
        };
        action.publish(carrier, &array(facts, outputs), source_ns)?;
        let Some(joint_command) = joint_command else { return Ok(()) };
        let command = JointState {
            header: Header { stamp: Time::from_ns(source_ns), frame_id: String::new() },
            name: facts.joints.clone(),
            position: outputs.iter().take(facts.joints.len()).map(|it| f64::from(*it)).collect(),
            ..JointState::default()
        };
        joint_command.publish(carrier, &command, source_ns)
    }

    /// What carries it.
    pub fn carrier(&mut self) -> &mut C {
        &mut self.carrier
    }
}

/// Outputs as an array whose one dimension has the name of the output, where there is but one.
fn array(facts: &PolicyFacts, outputs: &[f32]) -> Float32MultiArray {
    let label = match &*facts.outputs {
        [(name, _)] => name.clone(),
        _ => "outputs".to_owned(),
    };
    // More numbers than 2^32 are refused where they are written.
    let size = outputs.len() as u32;
    let dim = vec![MultiArrayDimension { label, size, stride: size }];
    Float32MultiArray { layout: MultiArrayLayout { dim, data_offset: 0 }, data: outputs.to_vec() }
}

/// Most publishers leave the layout empty; where one says something it has to be true.
fn check_layout(layout: &MultiArrayLayout, got: usize) -> Result<(), ObservationError> {
    let MultiArrayLayout { dim, data_offset: offset } = layout;
    let sizes = dim.iter().map(|dimension| u64::from(dimension.size));
    let said = if dim.is_empty() { got as u64 } else { sizes.fold(1, u64::saturating_mul) };
    if *offset == 0 && said == got as u64 {
        return Ok(());
    }
    Err(ObservationError::Layout { said, offset: *offset, got })
}
