//! The bell of a link: the doorbell, or iceoryx2 events.

use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::{read, write};
use sortie_core::link::{Clock, LinkError, Wake};
use sortie_core::wire::Role;

use super::opener::Opener;
use super::{LinkService, services};
use crate::domain::BellKind;
use crate::doorbell::Doorbell;
use crate::error::Error;
use crate::stop::{MonotonicClock, Waker};

pub(super) enum LinkBell<S: LinkService> {
    Doorbell(Doorbell),
    Event(EventBell<S>),
}

impl<S: LinkService> LinkBell<S> {
    /// The bell of `own`, which rings those of `peers`.
    pub(super) fn open(opener: &Opener<'_, S>, own: Role, peers: &[Role]) -> Result<Self, Error> {
        let setup = opener.setup;
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

/// The own bell, and those of the peers.
pub(super) struct EventBell<S: LinkService> {
    listener: Listener<S>,
    peers: Vec<(Role, Notifier<S>)>,
    /// Written to by the own process, which has no notifier that a signal handler could use.
    wake: Arc<OwnedFd>,
}

impl<S: LinkService> EventBell<S> {
    fn new(opener: &Opener<'_, S>, own: Role, peers: &[Role]) -> Result<Self, Error> {
        let name = |role| {
            services::bell_name(role).ok_or_else(|| Error::SharedMemory {
                what: format!("bell of {role:?}"),
                problem: "this role has none".to_string(),
            })
        };
        let listener = opener.listener(name(own)?)?;
        let peers = peers
            .iter()
            .map(|&role| Ok((role, opener.notifier(name(role)?, own)?)))
            .collect::<Result<_, Error>>()?;
        let wake = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)
            .map_err(|error| Error::io("create", "eventfd")(error.into()))?;
        Ok(Self { listener, peers, wake: Arc::new(wake) })
    }

    fn ring(&self, role: Role) -> Result<(), LinkError> {
        let notifiers = self.peers.iter().filter(|(peer, _)| *peer == role);
        for (_, notifier) in notifiers {
            notifier.notify().map_err(|_| LinkError::Bell)?;
        }
        Ok(())
    }

    fn waker(&self) -> Waker {
        let wake = Arc::clone(&self.wake);
        Waker::new(move || {
            // A count that is full wakes as well.
            let _ = write(&*wake, &1_u64.to_ne_bytes());
        })
    }

    /// Whether somebody rang; forgets it.
    fn drain(&self) -> bool {
        // A listener that fails is looked at again after the next heartbeat.
        let is_rung = self.listener.try_wait(|_| {}).is_ok_and(|rings| rings > 0);
        let is_woken = read(&*self.wake, &mut [0_u8; 8]).is_ok();
        is_rung || is_woken
    }

    fn wait_until(&self, until_ns: u64) -> Wake {
        if self.drain() {
            return Wake::Rung;
        }
        let now = MonotonicClock.now_ns();
        if now >= until_ns {
            return Wake::Timeout;
        }
        let left = until_ns - now;
        let timeout = Timespec {
            tv_sec: (left / 1_000_000_000) as i64,
            tv_nsec: (left % 1_000_000_000) as _,
        };
        let mut descriptors = [
            PollFd::from_borrowed_fd(self.descriptor(), PollFlags::IN),
            PollFd::new(&*self.wake, PollFlags::IN),
        ];
        // Time-out, ring and signal need no telling apart: the topics are looked at in any case.
        let _ = poll(&mut descriptors, Some(&timeout));
        if self.drain() { Wake::Rung } else { Wake::Timeout }
    }

    #[allow(unsafe_code)]
    fn descriptor(&self) -> BorrowedFd<'_> {
        let descriptor = S::descriptor(&self.listener);
        // SAFETY: the listener owns the descriptor and keeps it open for as long as it lives; the
        // result borrows `self`, which owns the listener. It is neither stored nor closed here.
        unsafe { BorrowedFd::borrow_raw(descriptor.native_handle()) }
    }
}
