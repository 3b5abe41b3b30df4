//! The bell of a link: the doorbell, or events.

use sortie_core::link::{LinkError, Wake};
use sortie_core::wire::Role;

use super::LinkService;
use super::event::EventBell;
use super::opener::Opener;
use crate::domain::BellKind;
use crate::doorbell::Doorbell;
use crate::error::Error;
use crate::waker::Waker;

pub(super) enum LinkBell<S: LinkService> {
    Doorbell(Doorbell),
    Event(EventBell<S>),
}

impl<S: LinkService> LinkBell<S> {
    /// The bell of `own`, which rings those of `peers`.
    pub(super) fn open(opener: &Opener<'_, S>, own: Role, peers: &[Role]) -> Result<Self, Error> {
        let setup = opener.setup();
        Ok(match setup.bell {
            BellKind::Doorbell => Self::Doorbell(Doorbell::open(setup.domain, own, setup.linger)?),
            BellKind::Event => Self::Event(EventBell::new(opener, own, peers)?),
        })
    }

    /// Rings by events wait in the listener until they are drained: there is nothing to remember.
    pub(super) fn token(&self) -> u32 {
        match self {
            Self::Doorbell(bell) => bell.token(),
            Self::Event(_) => 0,
        }
    }

    /// Waits for so many rings, or for any.
    pub(super) fn wait(&self, token: u32, rings: Option<u32>, until_ns: u64) -> Wake {
        match (self, rings) {
            (Self::Doorbell(bell), Some(rings)) => bell.wait_for_rings(token, rings, until_ns),
            (Self::Doorbell(bell), None) => bell.wait_until(token, until_ns),
            (Self::Event(bell), _) => bell.wait_until(until_ns),
        }
    }

    pub(super) fn ring(&self, role: Role) -> Result<(), LinkError> {
        match self {
            Self::Doorbell(bell) => bell.ring(role),
            Self::Event(bell) => bell.ring(role),
        }
    }

    pub(super) fn waker(&self) -> Waker {
        match self {
            Self::Doorbell(bell) => bell.waker(),
            Self::Event(bell) => bell.waker(),
        }
    }
}
