//! The two ends of a served policy: observations one way, answers the other; and how its server is looked after.

use std::time::Duration;

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use sortie_core::link::{LinkError, StatRx, Wake};
use sortie_core::wire::{ABI, ControlRep, ControlReq, MessageError, Role, ServedFormat, StatMsg};
use zerocopy::IntoBytes;

use super::open::{
    ByteTopic, BytesReceiver, BytesSender, Receiver, RequestServer, Sender, Services, attributes,
    drain, failed, node,
};
use super::services::{self, Block, Message as _, StatPayload, Topic};
use super::watcher::{Bells, ControlRx, IoxControl, serve};
use super::{InterProcess, LinkService};
use crate::domain::Domain;
use crate::doorbell::Doorbell;
use crate::error::Error;
use crate::stop::Waker;

/// A message that was received.
pub(crate) struct Message<S: LinkService> {
    sample: Sample<S, [Block], ()>,
    /// It ends inside of the last block.
    bytes: usize,
}

impl<S: LinkService> Message<S> {
    pub(crate) fn bytes(&self) -> &[u8] {
        let whole = self.sample.payload().as_bytes();
        whole.get(..self.bytes).unwrap_or(whole)
    }
}

/// What an end is opened with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ServedSetup<'a> {
    /// The domain, which this process has entered.
    pub(crate) domain: &'a Domain,
    pub(crate) format: ServedFormat,
    /// How long waits linger before they sleep.
    pub(crate) linger: Duration,
}

/// One end: the server's, or its client's.
pub(crate) struct ServedLink<S: LinkService = InterProcess> {
    sender: BytesSender<S, ()>,
    receiver: BytesReceiver<S, ()>,
    /// Bytes of every message that is sent.
    sent: usize,
    /// Bytes of every message that is received.
    received: usize,
    bell: Doorbell,
    peer: Role,
    /// Dropped last.
    node: Node<S>,
}

impl<S: LinkService> ServedLink<S> {
    /// The end that answers.
    pub(crate) fn server(setup: &ServedSetup<'_>) -> Result<Self, Error> {
        let (observations, answers) = topics();
        let asked = setup.format.observation_bytes();
        let answered = setup.format.answer_bytes();
        Self::open(setup, (answers, answered), (observations, asked), [Role::Runner, Role::World])
    }

    /// The end that asks.
    pub(crate) fn client(setup: &ServedSetup<'_>) -> Result<Self, Error> {
        let (observations, answers) = topics();
        let asked = setup.format.observation_bytes();
        let answered = setup.format.answer_bytes();
        Self::open(setup, (observations, asked), (answers, answered), [Role::World, Role::Runner])
    }

    fn open(
        setup: &ServedSetup<'_>,
        (sender, sent): (Topic, usize),
        (receiver, received): (Topic, usize),
        [own, peer]: [Role; 2],
    ) -> Result<Self, Error> {
        let node = quiet_node(setup, "policy")?;
        let attributes = attributes(setup.format.schema(), ABI)?;
        let services = services_of(setup, &node, &attributes);
        let receiver = services.bytes_receiver(&messages(receiver))?;
        let sender = services.bytes_sender(&messages(sender), sent)?;
        let bell = Doorbell::open(setup.domain, own, setup.linger)?;
        Ok(Self { sender, receiver, sent, received, bell, peer, node })
    }

    /// Writes a message in shared memory, sends it, and wakes the other end.
    pub(crate) fn send(
        &self,
        write: impl FnOnce(&mut [u8]) -> Result<(), MessageError>,
    ) -> Result<(), Error> {
        let blocks = Block::holding(self.sent);
        let mut sample = self.sender.loan_slice(blocks).map_err(failed("loan"))?;
        let whole = sample.payload_mut().as_mut_bytes();
        let bytes = whole.get_mut(..self.sent).unwrap_or_default();
        write(bytes).map_err(failed("message"))?;
        sample.send().map_err(failed("send"))?;
        Ok(self.bell.ring(self.peer)?)
    }

    /// The next message that waits.
    pub(crate) fn receive(&self) -> Result<Option<Message<S>>, Error> {
        let received = self.receiver.receive().map_err(failed("receive"))?;
        Ok(received.map(|sample| Message { sample, bytes: self.received }))
    }

    /// The bell's state, taken before looking for messages.
    pub(crate) fn token(&self) -> u32 {
        self.bell.token()
    }

    /// Waits for the other end's bell since `token` was taken.
    pub(crate) fn wait(&self, token: u32, until_ns: u64) -> Wake {
        self.bell.wait_for_rings(token, 1, until_ns)
    }

    /// What the server tells of itself, and is told: over ports of their own, which no observation waits for.
    ///
    /// # Errors
    /// Shared memory cannot be used.
    pub(crate) fn presence(&self, setup: &ServedSetup<'_>) -> Result<ServedPresence<S>, Error> {
        let attributes = attributes(setup.format.schema(), ABI)?;
        let services = services_of(setup, &self.node, &attributes);
        Ok(ServedPresence {
            statuses: services.sender(services::served_statuses())?,
            requests: services.control_server(services::served_control())?,
        })
    }

    pub(crate) fn waker(&self) -> Waker {
        self.bell.waker()
    }

    /// Lets go of the dead, and connects to who is new.
    pub(crate) fn housekeep(&self) {
        // A connection that fails is tried again at the next heartbeat.
        let _ = self.sender.update_connections();
        let _ = self.receiver.update_connections();
    }
}

/// The ports by which a server is looked after.
pub(crate) struct ServedPresence<S: LinkService = InterProcess> {
    statuses: Sender<S, StatPayload>,
    requests: RequestServer<S>,
}

impl<S: LinkService> ServedPresence<S> {
    /// Sends a status. One that fails is followed by the next.
    pub(crate) fn tell(&self, status: &StatMsg) {
        let _ = self.statuses.update_connections();
        let _ = self.statuses.send_copy(StatPayload::wrap(status));
    }
}

impl<S: LinkService> ControlRx for ServedPresence<S> {
    fn answer_requests(&mut self, answer: &mut dyn FnMut(&ControlReq) -> ControlRep) -> bool {
        serve(&self.requests, answer)
    }
}

/// Hears what a server tells of itself.
pub(crate) struct ServedWatcher {
    statuses: Receiver<InterProcess, StatPayload>,
    /// Dropped last.
    _node: Node<InterProcess>,
}

impl ServedWatcher {
    pub(crate) fn open(setup: &ServedSetup<'_>) -> Result<Self, Error> {
        let node = quiet_node::<InterProcess>(setup, "watcher")?;
        let attributes = attributes(setup.format.schema(), ABI)?;
        let services = services_of(setup, &node, &attributes);
        Ok(Self { statuses: services.receiver(services::served_statuses())?, _node: node })
    }
}

impl StatRx for ServedWatcher {
    fn receive_statuses(&mut self, take: &mut dyn FnMut(&StatMsg)) -> Result<(), LinkError> {
        drain(&self.statuses, LinkError::Statuses, take)
    }
}

impl IoxControl {
    /// The same for the server of a policy.
    pub(crate) fn open_served(setup: &ServedSetup<'_>) -> Result<Self, Error> {
        let node = quiet_node::<InterProcess>(setup, "control")?;
        let attributes = attributes(setup.format.schema(), ABI)?;
        let services = services_of(setup, &node, &attributes);
        let client = services.control_client(services::served_control())?;
        let bell = Doorbell::open(setup.domain, Role::Watcher, Duration::ZERO)?;
        Ok(Self::new(client, Bells::Doorbell(bell), node))
    }
}

fn quiet_node<S: LinkService>(setup: &ServedSetup<'_>, name: &str) -> Result<Node<S>, Error> {
    set_log_level_from_env_or(LogLevel::Fatal);
    node::<S>(setup.domain, name)
}

fn services_of<'a, S: LinkService>(
    setup: &ServedSetup<'a>,
    node: &'a Node<S>,
    attributes: &'a AttributeVerifier,
) -> Services<'a, S> {
    Services {
        node,
        domain: setup.domain,
        schema: setup.format.schema(),
        attributes,
        name: "policy",
        processes: PROCESSES,
    }
}

/// Most processes that are at a policy at once: a server and a client, what killed ones leave until it is freed,
/// and those that free it.
const PROCESSES: usize = 16;

/// Observations and answers.
fn topics() -> (Topic, Topic) {
    (services::observations(), services::answers())
}

fn messages(topic: Topic) -> ByteTopic {
    ByteTopic { topic, name: topic.name.to_owned() }
}

/// Shared memory that both ends take at most, in bytes.
pub(crate) fn served_bytes(format: &ServedFormat) -> u64 {
    let (observations, answers) = topics();
    let of = |topic: Topic, bytes: usize| services::slots(topic) * (bytes + 128);
    let presence = services::status_bytes(services::served_statuses())
        + services::control_bytes(services::served_control());
    let messages =
        of(observations, format.observation_bytes()) + of(answers, format.answer_bytes());
    (messages + presence) as u64
}
