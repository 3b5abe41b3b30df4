//! Opening the services and ports of a team, and how a world's frames reach their readers: one for all, or one for each
//! agent.

use std::fmt::Debug;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use sortie_core::link::{FrameBlock, LinkError};
use sortie_core::wire::{ABI, FrameFormat, FrameHeader, FrameLayout, FrameView, Role};
use zerocopy::IntoBytes;

use super::LinkService;
use super::open::{
    ByteTopic, Bytes, BytesReceiver, BytesSender, Receiver, RequestClient, RequestServer, Sender,
    Services, attributes, failed, node, retry, service_name,
};
use super::services::{self, Block, FrameHeaderPayload, LinkSetup, Message, Topic};
use crate::error::Error;

pub(super) type FrameTopic<S> = Bytes<S, FrameHeaderPayload>;
type FrameSender<S> = BytesSender<S, FrameHeaderPayload>;
pub(super) type FrameReceiver<S> = BytesReceiver<S, FrameHeaderPayload>;

/// A node, and what is needed to open services with it.
pub(super) struct Opener<'a, S: LinkService> {
    node: Node<S>,
    pub(super) setup: &'a LinkSetup<'a>,
    attributes: AttributeVerifier,
}

impl<'a, S: LinkService> Opener<'a, S> {
    pub(super) fn new(setup: &'a LinkSetup<'a>) -> Result<Self, Error> {
        // Errors come back as values; `IOX2_LOG_LEVEL` brings the library's own words.
        set_log_level_from_env_or(LogLevel::Fatal);
        let node = node(setup.domain, setup.name)?;
        Ok(Self { node, setup, attributes: attributes(setup.format.schema, ABI)? })
    }

    pub(super) fn into_node(self) -> Node<S> {
        self.node
    }

    fn agents(&self) -> usize {
        self.setup.format.layout.shape().agents
    }

    fn port_name(&self) -> Result<PortName, Error> {
        PortName::new(self.setup.name).map_err(failed("port name"))
    }

    /// The service of world frames, or that of one agent's private ones.
    pub(super) fn frames(&self, agent: Option<usize>) -> Result<FrameTopic<S>, Error> {
        self.services().bytes(&self.frame_topic(agent))
    }

    fn frame_topic(&self, agent: Option<usize>) -> ByteTopic {
        match agent {
            None => {
                let topic = services::frames(self.agents());
                ByteTopic { topic, name: topic.name.to_owned() }
            }
            Some(agent) => {
                let name = services::private_frames_name(agent);
                ByteTopic { topic: services::private_frames(), name }
            }
        }
    }

    /// Sends frames of `layout`: the world's, or those of its owner.
    fn frame_sender(&self, layout: &FrameLayout) -> Result<FrameSender<S>, Error> {
        self.services().bytes_sender(&self.frame_topic(layout.owner()), layout.payload_bytes())
    }

    /// Receives world frames, or the private ones of `agent`.
    pub(super) fn frame_receiver(&self, agent: Option<usize>) -> Result<FrameReceiver<S>, Error> {
        self.services().bytes_receiver(&self.frame_topic(agent))
    }

    /// Receives world frames, and has room for those of a while.
    pub(super) fn frame_recorder(&self) -> Result<FrameReceiver<S>, Error> {
        let ByteTopic { topic, name } = self.frame_topic(None);
        self.services().bytes_receiver(&ByteTopic { topic: topic.for_recorder(), name })
    }

    pub(super) fn sender<M: Message>(
        &self,
        topic: fn(usize) -> Topic,
    ) -> Result<Sender<S, M>, Error> {
        self.services().sender(topic(self.agents()))
    }

    pub(super) fn receiver<M: Message>(
        &self,
        topic: fn(usize) -> Topic,
    ) -> Result<Receiver<S, M>, Error> {
        self.services().receiver(topic(self.agents()))
    }

    /// The same with room for the messages of a while.
    pub(super) fn recorder<M: Message>(
        &self,
        topic: fn(usize) -> Topic,
    ) -> Result<Receiver<S, M>, Error> {
        self.services().receiver(topic(self.agents()).for_recorder())
    }

    pub(super) fn control_server(&self) -> Result<RequestServer<S>, Error> {
        self.services().control_server(services::control(self.agents()))
    }

    pub(super) fn control_client(&self) -> Result<RequestClient<S>, Error> {
        self.services().control_client(services::control(self.agents()))
    }

    fn services(&self) -> Services<'_, S> {
        Services {
            node: &self.node,
            domain: self.setup.domain,
            schema: self.setup.format.schema,
            attributes: &self.attributes,
            name: self.setup.name,
            processes: services::processes(self.agents()),
        }
    }

    fn bell(
        &self,
        name: &'static str,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<S>, Error> {
        let service = service_name(name)?;
        let ports = services::bell_ports(self.agents());
        self.retry(name, || {
            self.node
                .service_builder(&service)
                .event()
                .event_id_max_value(services::BELL_IDS)
                .max_listeners(ports)
                .max_notifiers(ports)
                .max_nodes(services::processes(self.agents()))
                .open_or_create_with_attributes(&self.attributes)
        })
    }

    pub(super) fn listener(&self, name: &'static str) -> Result<Listener<S>, Error> {
        let (service, port) = (self.bell(name)?, self.port_name()?);
        self.retry(name, || service.listener_builder().name(&port).create())
    }

    pub(super) fn notifier(&self, name: &'static str, own: Role) -> Result<Notifier<S>, Error> {
        let (service, port) = (self.bell(name)?, self.port_name()?);
        let id = EventId::new(services::bell_id(own));
        self.retry(name, || service.notifier_builder().name(&port).default_event_id(id).create())
    }

    fn retry<T, E: Debug>(
        &self,
        what: &str,
        attempt: impl FnMut() -> Result<T, E>,
    ) -> Result<T, Error> {
        retry(&self.node, (self.setup.domain, self.setup.format.schema), what, attempt)
    }
}

/// Writes a frame in place and returns its header.
type Fill<'a> = &'a mut dyn FnMut(&mut [u8]) -> Result<FrameHeader, LinkError>;

/// The frame topics of a world.
pub(super) struct WorldFrames<S: LinkService> {
    format: FrameFormat,
    /// All agents' observations: for all in a domain that shares its frames, else for the allocator, if there is one.
    whole: Option<FrameSender<S>>,
    /// One topic for each agent of a domain whose frames are private.
    private: Vec<(FrameLayout, FrameSender<S>)>,
    /// Where a frame is written that nobody gets as a whole.
    unsent: Vec<FrameBlock>,
}

impl<S: LinkService> WorldFrames<S> {
    pub(super) fn shared(opener: &Opener<'_, S>) -> Result<Self, Error> {
        let format = opener.setup.format;
        let whole = Some(opener.frame_sender(&format.layout)?);
        Ok(Self { format, whole, private: Vec::new(), unsent: Vec::new() })
    }

    pub(super) fn private(opener: &Opener<'_, S>, has_allocator: bool) -> Result<Self, Error> {
        let format = opener.setup.format;
        let whole = has_allocator.then(|| opener.frame_sender(&format.layout)).transpose()?;
        let shape = format.layout.shape();
        let of_agent = |agent| {
            let layout = FrameLayout::private(shape, agent)?;
            Ok((layout, opener.frame_sender(&layout)?))
        };
        let private = (0..shape.agents).map(of_agent).collect::<Result<_, Error>>()?;
        let blocks = format.layout.payload_bytes() / size_of::<FrameBlock>();
        let blocks = if has_allocator { 0 } else { blocks };
        Ok(Self { format, whole, private, unsent: vec![FrameBlock::zeroed(); blocks] })
    }

    pub(super) fn update_connections(&self) {
        let senders = self.private.iter().map(|(_, sender)| sender).chain(&self.whole);
        for sender in senders {
            // A connection that fails is tried again at the next heartbeat.
            let _ = sender.update_connections();
        }
    }

    /// Sends one frame; each agent's own part of it where frames are private.
    pub(super) fn send(&mut self, fill: Fill<'_>) -> Result<(), LinkError> {
        let Self { format, whole, private, unsent } = self;
        let Some(whole) = whole else {
            let header = fill(unsent.as_mut_bytes())?;
            return send_parts(private, &header, unsent.as_bytes(), format);
        };
        let blocks = Block::holding(format.layout.payload_bytes());
        let mut sample = whole.loan_slice(blocks).map_err(|_| LinkError::Frames)?;
        let header = fill(sample.payload_mut().as_mut_bytes())?;
        send_parts(private, &header, sample.payload().as_bytes(), format)?;
        *sample.user_header_mut() = FrameHeaderPayload::wrap(&header);
        sample.send().map(drop).map_err(|_| LinkError::Frames)
    }
}

/// Cuts a frame that was just written.
fn send_parts<S: LinkService>(
    private: &[(FrameLayout, FrameSender<S>)],
    header: &FrameHeader,
    payload: &[u8],
    format: &FrameFormat,
) -> Result<(), LinkError> {
    if private.is_empty() {
        return Ok(());
    }
    let view = FrameView::new(header, payload, format).map_err(LinkError::Frame)?;
    for (layout, sender) in private {
        let loaned = sender.loan_slice(Block::holding(layout.payload_bytes()));
        let mut sample = loaned.map_err(|_| LinkError::Frames)?;
        let header = view
            .write_private(layout, sample.payload_mut().as_mut_bytes())
            .map_err(LinkError::Frame)?;
        *sample.user_header_mut() = FrameHeaderPayload::wrap(&header);
        sample.send().map_err(|_| LinkError::Frames)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt;
    use std::time::Duration;

    use sortie_core::Shape;
    use sortie_core::wire::FrameFormat;

    use super::*;
    use crate::domain::{BellKind, Domain};
    use crate::iox::InterProcess;

    fn format() -> FrameFormat {
        let shape = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        FrameFormat { layout: FrameLayout::new(shape).unwrap(), schema: 7 }
    }

    #[test]
    fn every_object_has_its_memory_before_anything_is_sent() {
        let domain = Domain::new(&format!("reserved-{}", std::process::id())).unwrap();
        let _member = domain.enter().unwrap();
        let (name, bell) = ("test", BellKind::Doorbell);
        let setup =
            LinkSetup { domain: &domain, format: format(), name, bell, linger: Duration::ZERO };
        let opener = Opener::<InterProcess>::new(&setup).unwrap();
        let _frames = opener.frame_sender(&format().layout).unwrap();
        let objects = domain.shared_memory().unwrap();
        assert!(objects.len() > 1, "{objects:?}");
        for object in objects {
            let found = object.metadata().unwrap();
            assert!(found.blocks() * 512 >= found.len(), "{}: {found:?}", object.display());
        }
    }

    #[test]
    fn services_of_another_schema_or_abi_are_refused() {
        let domain = Domain::new(&format!("abi-{}", std::process::id())).unwrap();
        let _member = domain.enter().unwrap();
        let (name, bell) = ("test", BellKind::Doorbell);
        let format = format();
        let setup = LinkSetup { domain: &domain, format, name, bell, linger: Duration::ZERO };
        let first = Opener::<InterProcess>::new(&setup).unwrap();
        let _frames = first.frames(None).unwrap();
        for (schema, abi) in [(8, ABI), (7, ABI + 1)] {
            let attributes = attributes(schema, abi).unwrap();
            let other = Opener { attributes, ..Opener::<InterProcess>::new(&setup).unwrap() };
            let refused = other.frames(None).unwrap_err();
            assert!(matches!(refused, Error::SchemaInUse { .. }), "{refused}");
            assert_eq!(refused.exit_code(), 78);
        }
    }
}
