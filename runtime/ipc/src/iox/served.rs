//! The two ends of a served policy: observations one way, answers the other.

use std::time::Duration;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use sortie_core::link::Wake;
use sortie_core::wire::{ABI, MessageError, ObservationHead, Role, ServedFormat};

use super::InterProcess;
use super::open::{attributes, failed, node, retry, service_name};
use super::services::{self, Topic};
use crate::domain::Domain;
use crate::doorbell::Doorbell;
use crate::error::Error;
use crate::waker::Waker;

type Message = Sample<InterProcess, [u8], ()>;

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
pub(crate) struct ServedLink {
    sender: Publisher<InterProcess, [u8], ()>,
    receiver: Subscriber<InterProcess, [u8], ()>,
    /// Bytes of every message that is sent.
    bytes: usize,
    bell: Doorbell,
    peer: Role,
    /// Dropped last.
    _node: Node<InterProcess>,
}

impl ServedLink {
    /// The end that answers.
    pub(crate) fn server(setup: &ServedSetup<'_>) -> Result<Self, Error> {
        let (observations, answers) = topics();
        let bytes = setup.format.answer_bytes();
        Self::open(setup, (answers, bytes), observations, [Role::Runner, Role::World])
    }

    /// The end that asks.
    pub(crate) fn client(setup: &ServedSetup<'_>) -> Result<Self, Error> {
        let (observations, answers) = topics();
        let bytes = setup.format.observation_bytes();
        Self::open(setup, (observations, bytes), answers, [Role::World, Role::Runner])
    }

    fn open(
        setup: &ServedSetup<'_>,
        (sent, bytes): (Topic, usize),
        received: Topic,
        [own, peer]: [Role; 2],
    ) -> Result<Self, Error> {
        set_log_level_from_env_or(LogLevel::Fatal);
        let node = node::<InterProcess>(setup.domain, "policy")?;
        let schema = setup.format.schema();
        let attributes = attributes(schema, ABI)?;
        let alignment = Alignment::new(align_of::<ObservationHead>())
            .ok_or("not a power of two")
            .map_err(failed("alignment"))?;
        let service = |topic: Topic| {
            let name = service_name(topic.name)?;
            retry(&node, (setup.domain, schema), topic.name, || {
                node.service_builder(&name)
                    .publish_subscribe::<[u8]>()
                    .payload_alignment(alignment)
                    .max_publishers(topic.publishers)
                    .max_subscribers(topic.subscribers)
                    .subscriber_max_buffer_size(topic.buffer)
                    .history_size(topic.history)
                    .subscriber_max_borrowed_samples(topic.borrow)
                    .enable_safe_overflow(true)
                    .max_nodes(PROCESSES)
                    .open_or_create_with_attributes(&attributes)
            })
        };
        let (out, back) = (service(sent)?, service(received)?);
        let receiver = retry(&node, (setup.domain, schema), received.name, || {
            back.subscriber_builder().buffer_size(received.buffer).create()
        })?;
        let sender = retry(&node, (setup.domain, schema), sent.name, || {
            out.publisher_builder()
                .initial_max_slice_len(bytes)
                .allocation_strategy(AllocationStrategy::Static)
                .max_loaned_samples(sent.loan)
                .create()
        })?;
        let bell = Doorbell::open(setup.domain, own, setup.linger)?;
        Ok(Self { sender, receiver, bytes, bell, peer, _node: node })
    }

    /// Writes a message in shared memory, sends it, and wakes the other end.
    pub(crate) fn send(
        &self,
        write: impl FnOnce(&mut [u8]) -> Result<(), MessageError>,
    ) -> Result<(), Error> {
        let mut sample = self.sender.loan_slice(self.bytes).map_err(failed("loan"))?;
        write(sample.payload_mut()).map_err(failed("message"))?;
        sample.send().map_err(failed("send"))?;
        Ok(self.bell.ring(self.peer)?)
    }

    /// The next message that waits.
    pub(crate) fn receive(&self) -> Result<Option<Message>, Error> {
        self.receiver.receive().map_err(failed("receive"))
    }

    /// The bell's state, taken before looking for messages.
    pub(crate) fn token(&self) -> u32 {
        self.bell.token()
    }

    /// Waits for the other end's bell since `token` was taken.
    pub(crate) fn wait(&self, token: u32, until_ns: u64) -> Wake {
        self.bell.wait_for_rings(token, 1, until_ns)
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

/// Most processes that are at a policy at once: a server and a client, what killed ones leave until it is freed,
/// and those that free it.
const PROCESSES: usize = 16;

/// Observations and answers.
fn topics() -> (Topic, Topic) {
    (services::observations(), services::answers())
}

/// Shared memory that both ends take at most, in bytes.
pub(crate) fn served_bytes(format: &ServedFormat) -> u64 {
    let (observations, answers) = topics();
    let of = |topic: Topic, bytes: usize| services::slots(topic) * (bytes + 128);
    (of(observations, format.observation_bytes()) + of(answers, format.answer_bytes())) as u64
}
