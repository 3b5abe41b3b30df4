//! Opening nodes, services and ports, with the retries that concurrent starts need.

use std::fmt::Debug;
use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::publish_subscribe as publish_subscribe_builder;
use iceoryx2::service::port_factory::{publish_subscribe, request_response};
use sortie_core::link::LinkError;

use super::services::{AnswerPayload, Block, Control, Message, RequestPayload, Topic};
use super::{InterProcess, LinkService};
use crate::domain::Domain;
use crate::error::Error;

/// Pauses between attempts: 1, 2, 4 … 64 ms, and 64 ms again until about 3 s have passed.
const FIRST_PAUSE: Duration = Duration::from_millis(1);
const LONGEST_PAUSE: Duration = Duration::from_millis(64);
const ATTEMPTS: u32 = 52;

/// What passes while other processes start or end.
const PASSING: [&str; 6] = [
    "SystemInFlux",
    "IsBeingCreatedByAnotherInstance",
    "IsMarkedForDestruction",
    "HangsInCreation",
    "ServiceInCorruptedState",
    "UnableToCreateServiceTag",
];

pub(super) type Sender<S, M> = Publisher<S, M, ()>;
pub(super) type Receiver<S, M> = Subscriber<S, M, ()>;
type ControlService<S> = request_response::PortFactory<S, RequestPayload, (), AnswerPayload, ()>;
pub(super) type RequestServer<S> = Server<S, RequestPayload, (), AnswerPayload, ()>;
pub(super) type RequestClient<S> = Client<S, RequestPayload, (), AnswerPayload, ()>;
pub(super) type PendingAnswers<S> = PendingResponse<S, RequestPayload, (), AnswerPayload, ()>;

/// A topic whose messages are bytes, in whole blocks, behind headers `H`.
pub(super) type Bytes<S, H> = publish_subscribe::PortFactory<S, [Block], H>;
pub(super) type BytesSender<S, H> = Publisher<S, [Block], H>;
pub(super) type BytesReceiver<S, H> = Subscriber<S, [Block], H>;

/// Which topic that is.
#[derive(Clone, Debug)]
pub(super) struct ByteTopic {
    pub(super) topic: Topic,
    /// The service's, where a topic has several.
    pub(super) name: String,
}

/// What all services of one schema are opened with.
pub(super) struct Services<'a, S: LinkService> {
    pub(super) node: &'a Node<S>,
    pub(super) domain: &'a Domain,
    pub(super) schema: u64,
    pub(super) attributes: &'a AttributeVerifier,
    /// Name of the ports.
    pub(super) name: &'a str,
    /// Most processes that are at a service at once.
    pub(super) processes: usize,
}

impl<S: LinkService> Services<'_, S> {
    fn port_name(&self) -> Result<PortName, Error> {
        PortName::new(self.name).map_err(failed("port name"))
    }

    fn topic<M: Message>(
        &self,
        topic: Topic,
    ) -> Result<publish_subscribe::PortFactory<S, M, ()>, Error> {
        let name = service_name(topic.name)?;
        self.retry(topic.name, || {
            let service = self.node.service_builder(&name).publish_subscribe::<M>();
            self.sized(service, topic).open_or_create_with_attributes(self.attributes)
        })
    }

    fn sized<M: Debug + IceoryxSend + ?Sized, H: Debug + ZeroCopySend>(
        &self,
        service: publish_subscribe_builder::Builder<M, H, S>,
        topic: Topic,
    ) -> publish_subscribe_builder::Builder<M, H, S> {
        service
            .max_publishers(topic.publishers)
            .max_subscribers(topic.subscribers)
            .subscriber_max_buffer_size(topic.recorded)
            .history_size(topic.history)
            .subscriber_max_borrowed_samples(topic.borrow)
            .enable_safe_overflow(true)
            .max_nodes(self.processes)
    }

    pub(super) fn bytes<H: Debug + ZeroCopySend>(
        &self,
        ByteTopic { topic, name }: &ByteTopic,
    ) -> Result<Bytes<S, H>, Error> {
        let name = service_name(name)?;
        self.retry(topic.name, || {
            let service = self.node.service_builder(&name).publish_subscribe::<[Block]>();
            self.sized(service.user_header::<H>(), *topic)
                .open_or_create_with_attributes(self.attributes)
        })
    }

    /// Sends messages of at most so many bytes.
    pub(super) fn bytes_sender<H: Debug + ZeroCopySend>(
        &self,
        bytes: &ByteTopic,
        most: usize,
    ) -> Result<BytesSender<S, H>, Error> {
        let (service, name, topic) = (self.bytes(bytes)?, self.port_name()?, bytes.topic);
        self.retry(topic.name, || {
            service
                .publisher_builder()
                .name(&name)
                .initial_max_slice_len(Block::holding(most))
                .allocation_strategy(AllocationStrategy::Static)
                .max_loaned_samples(topic.loan)
                .create()
        })
    }

    pub(super) fn bytes_receiver<H: Debug + ZeroCopySend>(
        &self,
        bytes: &ByteTopic,
    ) -> Result<BytesReceiver<S, H>, Error> {
        let (service, name, topic) = (self.bytes(bytes)?, self.port_name()?, bytes.topic);
        self.retry(topic.name, || {
            service
                .subscriber_builder()
                .name(&name)
                .buffer_size(topic.buffer)
                .history_request(topic.history)
                .create()
        })
    }

    pub(super) fn sender<M: Message>(&self, topic: Topic) -> Result<Sender<S, M>, Error> {
        let (service, name) = (self.topic::<M>(topic)?, self.port_name()?);
        self.retry(topic.name, || {
            service.publisher_builder().name(&name).max_loaned_samples(topic.loan).create()
        })
    }

    pub(super) fn receiver<M: Message>(&self, topic: Topic) -> Result<Receiver<S, M>, Error> {
        let (service, name) = (self.topic::<M>(topic)?, self.port_name()?);
        self.retry(topic.name, || {
            service
                .subscriber_builder()
                .name(&name)
                .buffer_size(topic.buffer)
                .history_request(topic.history)
                .create()
        })
    }

    fn control(&self, control: Control) -> Result<ControlService<S>, Error> {
        let name = service_name(control.name)?;
        self.retry(control.name, || {
            self.node
                .service_builder(&name)
                .request_response::<RequestPayload, AnswerPayload>()
                .max_clients(control.clients)
                .max_servers(control.servers)
                .max_active_requests_per_client(control.active)
                .max_response_buffer_size(control.buffer)
                .max_loaned_requests(1)
                .enable_safe_overflow_for_requests(true)
                .enable_safe_overflow_for_responses(true)
                .enable_fire_and_forget_requests(true)
                .max_nodes(self.processes)
                .open_or_create_with_attributes(self.attributes)
        })
    }

    pub(super) fn control_server(&self, control: Control) -> Result<RequestServer<S>, Error> {
        let (service, name) = (self.control(control)?, self.port_name()?);
        self.retry(control.name, || service.server_builder().name(&name).create())
    }

    pub(super) fn control_client(&self, control: Control) -> Result<RequestClient<S>, Error> {
        let (service, name) = (self.control(control)?, self.port_name()?);
        self.retry(control.name, || service.client_builder().name(&name).create())
    }

    fn retry<T, E: Debug>(
        &self,
        what: &str,
        attempt: impl FnMut() -> Result<T, E>,
    ) -> Result<T, Error> {
        let opened = retry(self.node, (self.domain, self.schema), what, attempt)?;
        self.domain.reserve_objects()?;
        Ok(opened)
    }
}

/// Opens a service of a domain or creates a port, again and again while others are at it, or while dead processes
/// hold all places.
pub(super) fn retry<S: LinkService, T, E: Debug>(
    node: &Node<S>,
    (domain, schema): (&Domain, u64),
    what: &str,
    mut attempt: impl FnMut() -> Result<T, E>,
) -> Result<T, Error> {
    let refused = |problem: String| refused(domain, schema, what, problem);
    let mut pause = FIRST_PAUSE;
    for _ in 1..ATTEMPTS {
        let problem = match attempt() {
            Ok(opened) => return Ok(opened),
            Err(error) => format!("{error:?}"),
        };
        if problem.contains("ExceedsMax") {
            node.try_cleanup_dead_nodes();
        } else if !PASSING.iter().any(|passing| problem.contains(passing)) {
            return Err(refused(problem));
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
    attempt().map_err(|error| refused(format!("{error:?}")))
}

/// The library's error types differ by pattern and call; their names do not.
fn refused(domain: &Domain, schema: u64, what: &str, problem: String) -> Error {
    if ["IncompatibleAttributes", "IncompatibleTypes"].iter().any(|misfit| problem.contains(misfit))
    {
        return Error::SchemaInUse { domain: domain.id().to_string(), schema };
    }
    domain.explain(what, problem)
}

/// Sets the level of the library's log, which goes to standard error: 0 trace to 5 fatal. Returns whether
/// there is such a level.
pub(crate) fn set_log_level(number: u64) -> bool {
    let levels = [
        LogLevel::Trace,
        LogLevel::Debug,
        LogLevel::Info,
        LogLevel::Warn,
        LogLevel::Error,
        LogLevel::Fatal,
    ];
    let level = usize::try_from(number).ok().and_then(|number| levels.get(number));
    if let Some(level) = level {
        iceoryx2::prelude::set_log_level(*level);
    }
    level.is_some()
}

/// Frees what dead processes hold.
pub(crate) struct Cleaner(Node<InterProcess>);

impl Cleaner {
    pub(crate) fn open(domain: &Domain) -> Result<Self, Error> {
        node(domain, "caretaker").map(Self)
    }

    /// Where nobody else is at it.
    pub(crate) fn clean_up(&mut self) {
        self.0.try_cleanup_dead_nodes();
    }
}

/// Takes all messages that wait.
pub(super) fn drain<S: LinkService, M: Message>(
    receiver: &Receiver<S, M>,
    failure: LinkError,
    take: &mut dyn FnMut(&M::Wire),
) -> Result<(), LinkError> {
    while let Some(sample) = receiver.receive().map_err(|_| failure)? {
        take(sample.payload().message());
    }
    Ok(())
}

/// Sends one message.
pub(super) fn send<S: LinkService, M: Message>(
    sender: &Sender<S, M>,
    failure: LinkError,
    message: &M::Wire,
) -> Result<(), LinkError> {
    sender.send_copy(M::wrap(message)).map(|_| ()).map_err(|_| failure)
}

pub(super) fn node<S: LinkService>(domain: &Domain, name: &str) -> Result<Node<S>, Error> {
    let node = NodeBuilder::new()
        .name(&NodeName::new(name).map_err(failed("node name"))?)
        .config(&config(domain)?)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<S>()
        .map_err(|error| domain.explain("node", format!("{error:?}")))?;
    // The first node of a domain has just created them.
    domain.close_node_numbers()?;
    Ok(node)
}

pub(super) fn config(domain: &Domain) -> Result<Config, Error> {
    let root = domain.iox_root();
    let root = Path::new(root.to_string_lossy().as_bytes()).map_err(failed("root path"))?;
    let mut config = Config::default();
    config.global.set_root_path(&root);
    // Freeing what the dead left may block for ever on an object that one of them was creating: it is the work of
    // the caretaker's thread, and of nobody who has a role.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    config.global.prefix = FileName::new(domain.prefix.as_bytes()).map_err(failed("prefix"))?;
    Ok(config)
}

pub(super) fn attributes(schema: u64, abi: u16) -> Result<AttributeVerifier, Error> {
    let mut verifier = AttributeVerifier::new();
    for (key, value) in
        [("sortie.schema", format!("{schema:016x}")), ("sortie.abi", abi.to_string())]
    {
        let key = AttributeKey::new(key.as_bytes()).map_err(failed("attribute"))?;
        let value = AttributeValue::new(value.as_bytes()).map_err(failed("attribute"))?;
        verifier = verifier.require(&key, &value).map_err(failed("attribute"))?;
    }
    Ok(verifier)
}

pub(super) fn service_name(name: &str) -> Result<ServiceName, Error> {
    ServiceName::new(name).map_err(failed(name))
}

pub(super) fn failed<E: Debug>(what: &str) -> impl FnOnce(E) -> Error + use<'_, E> {
    move |error| Error::SharedMemory { what: what.to_string(), problem: format!("{error:?}") }
}
