//! Requests to the processes of a domain: every one of them gets every request, and answers.

use std::time::{Duration, Instant};

use iceoryx2::prelude::*;
use sortie_core::wire::{ControlRep, ControlReq, Role};

use super::message::{AnswerPayload, Message, RequestPayload};
use super::open::{RequestClient, RequestServer};
use super::opener::Opener;
use super::setup::LinkSetup;
use super::watcher::Bells;
use super::{InterProcess, LinkService};
use crate::error::Error;

/// Pause between two looks for answers.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Links whose process is told what to do.
pub trait ControlRx {
    /// Answers all requests that wait. Returns whether there was one.
    fn answer_requests(&mut self, answer: &mut dyn FnMut(&ControlReq) -> ControlRep) -> bool;
}

/// A process goes on whatever happens to who asks: what fails here is not answered.
pub(super) fn serve<S: LinkService>(
    server: &RequestServer<S>,
    answer: &mut dyn FnMut(&ControlReq) -> ControlRep,
) -> bool {
    let mut is_asked = false;
    while let Ok(Some(request)) = server.receive() {
        is_asked = true;
        let _ = request.send_copy(AnswerPayload::wrap(&answer(request.payload().message())));
    }
    is_asked
}

/// Tells the processes of a domain what to do.
pub struct IoxControl<S: LinkService = InterProcess> {
    client: RequestClient<S>,
    bells: Bells<S>,
    /// Dropped last.
    _node: Node<S>,
}

impl<S: LinkService> IoxControl<S> {
    /// Opens the service and the bells.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the domain runs another schema.
    pub fn open(setup: &LinkSetup<'_>) -> Result<Self, Error> {
        let opener = Opener::new(setup)?;
        let bells = Bells::open(&opener)?;
        Ok(Self::new(opener.control_client()?, bells, opener.into_node()))
    }

    pub(super) fn new(client: RequestClient<S>, bells: Bells<S>, node: Node<S>) -> Self {
        Self { client, bells, _node: node }
    }

    /// Asks all processes, and waits until all have answered, `patience` at most.
    ///
    /// # Errors
    /// The request could not be sent.
    pub fn ask(
        &mut self,
        request: &ControlReq,
        patience: Duration,
    ) -> Result<Vec<ControlRep>, Error> {
        let sent = self.client.send_copy(RequestPayload::wrap(request));
        let pending = sent.map_err(|error| Error::SharedMemory {
            what: "sortie/1/ctl".to_string(),
            problem: format!("{error:?}"),
        })?;
        for role in [Role::World, Role::Runner, Role::Allocator] {
            self.bells.ring(role)?;
        }
        let until = Instant::now() + patience;
        let mut answers = Vec::new();
        loop {
            while let Ok(Some(answer)) = pending.receive() {
                answers.push(*answer.payload().message());
            }
            let is_complete = answers.len() >= pending.number_of_server_connections();
            if is_complete || Instant::now() >= until {
                return Ok(answers);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}
