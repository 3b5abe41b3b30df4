//! A running team as one node: what its agents see and do, and who works on what, as topics.
//!
//! Whoever bridges listens to the team as a recorder does: nobody in the team notices, and nothing comes back from ROS.
//!
//! | topic | messages | when |
//! | --- | --- | --- |
//! | `agent_N/observation` | [`Observation`] | every frame that shows agent N |
//! | `agent_N/action` | [`Action`] | every answer for agent N |
//! | `allocation` | [`Allocation`] | every allocation |

use sortie_core::wire::{ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameView};

use crate::definition::DefinitionError;
use crate::messages::{Action, Allocation, Observation, Time};
use crate::node::{BridgeError, Carrier, Node, Publisher};
use crate::qos::Qos;

/// What a bridge must know of a team.
#[derive(Clone, Copy, Debug)]
pub struct TeamFacts {
    /// The domain's schema and layout, as its file says.
    pub format: FrameFormat,
    /// How much more the time since 1970 is than that of the domain's clock, in nanoseconds.
    pub ahead_ns: u64,
}

/// What was passed on since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bridged {
    /// Observations.
    pub observations: u64,
    /// Actions.
    pub actions: u64,
    /// Allocations.
    pub allocations: u64,
    /// Messages that are no message of this team, or contradict themselves.
    pub refused: u64,
}

/// The topics of one agent.
#[derive(Debug)]
struct AgentTopics {
    observation: Publisher,
    action: Publisher,
}

/// Passes on what a team says.
#[derive(Debug)]
pub struct TeamBridge<C: Carrier> {
    carrier: C,
    facts: TeamFacts,
    /// `[A]`
    agents: Vec<AgentTopics>,
    allocation: Publisher,
    bridged: Bridged,
}

impl<C: Carrier> TeamBridge<C> {
    /// Says that the node and all its publishers are there.
    ///
    /// # Errors
    /// [`BridgeError::Carrier`]; [`BridgeError::Definition`]: with the node's namespace a topic has more than 255 letters.
    pub fn open(
        mut carrier: C,
        node: &Node,
        facts: TeamFacts,
    ) -> Result<Self, BridgeError<C::Error>> {
        let allocation = node.publisher::<Allocation>(1, "allocation", Qos::TOPIC)?;
        let agent = |agent: usize| {
            let number = 2 * (agent as u64 + 1);
            let topic = |of: &str| format!("agent_{agent}/{of}");
            Ok(AgentTopics {
                observation: node.publisher::<Observation>(
                    number,
                    &topic("observation"),
                    Qos::SENSOR,
                )?,
                action: node.publisher::<Action>(number + 1, &topic("action"), Qos::TOPIC)?,
            })
        };
        let agents = (0..facts.format.layout.shape().agents).map(agent);
        let agents: Vec<AgentTopics> = agents.collect::<Result<_, DefinitionError>>()?;
        let of_agents = agents.iter().flat_map(|agent| [&agent.observation, &agent.action]);
        let publishers = std::iter::once(&allocation).chain(of_agents).map(Publisher::token);
        for token in std::iter::once(node.token()).chain(publishers) {
            carrier.declare(&token.to_string()).map_err(BridgeError::Carrier)?;
        }
        Ok(Self { carrier, facts, agents, allocation, bridged: Bridged::default() })
    }

    /// Passes on what each agent sees of a frame. Those that only warm caches, and frames of one agent, are passed over.
    ///
    /// # Errors
    /// [`BridgeError::Carrier`]. A frame that is not this team's is counted.
    pub fn frame(
        &mut self,
        header: &FrameHeader,
        payload: &[u8],
    ) -> Result<(), BridgeError<C::Error>> {
        if header.kind != FrameKind::World as u16 {
            return Ok(());
        }
        let Self { carrier, facts: TeamFacts { format, ahead_ns }, agents, bridged, .. } = self;
        let Ok(view) = FrameView::new(header, payload, format) else {
            bridged.refused += 1;
            return Ok(());
        };
        let source_ns = header.t_ns.saturating_add(*ahead_ns);
        let (stamp, features) = (Time::from_ns(source_ns), format.layout.shape().features);
        for (agent, AgentTopics { observation: topic, .. }) in (0..).zip(agents) {
            if !carrier.is_read(topic.key()) {
                continue;
            }
            if let Some(seen) = Observation::of_frame(&view, agent, features, stamp) {
                topic.publish(carrier, &seen, source_ns)?;
                bridged.observations += 1;
            }
        }
        Ok(())
    }

    /// Passes on what a runner answered.
    ///
    /// # Errors
    /// As [`Self::frame`].
    pub fn action(&mut self, message: &ActionMsg) -> Result<(), BridgeError<C::Error>> {
        let Self { carrier, facts: TeamFacts { format, ahead_ns }, agents, bridged, .. } = self;
        let topics = agents.get_mut(usize::from(message.agent));
        let Some(AgentTopics { action: topic, .. }) =
            topics.filter(|_| message.fits(format.schema))
        else {
            bridged.refused += 1;
            return Ok(());
        };
        let source_ns = message.t_ns.saturating_add(*ahead_ns);
        let answer = Action::of_message(message, Time::from_ns(source_ns));
        if let Some(answer) = answer.filter(|_| carrier.is_read(topic.key())) {
            topic.publish(carrier, &answer, source_ns)?;
            bridged.actions += 1;
        }
        Ok(())
    }

    /// Passes on what an allocator said.
    ///
    /// # Errors
    /// As [`Self::frame`].
    pub fn allocation(&mut self, message: &AllocMsg) -> Result<(), BridgeError<C::Error>> {
        let Self {
            carrier, facts: TeamFacts { format, ahead_ns }, allocation: topic, bridged, ..
        } = self;
        if message.check(format.schema, format.layout.shape()).is_err() {
            bridged.refused += 1;
            return Ok(());
        }
        let source_ns = message.t_ns.saturating_add(*ahead_ns);
        if carrier.is_read(topic.key()) {
            let message = Allocation::of_message(message, Time::from_ns(source_ns));
            topic.publish(carrier, &message, source_ns)?;
            bridged.allocations += 1;
        }
        Ok(())
    }

    /// What was passed on.
    pub fn bridged(&self) -> Bridged {
        self.bridged
    }

    /// What carries it.
    pub fn carrier(&mut self) -> &mut C {
        &mut self.carrier
    }
}
