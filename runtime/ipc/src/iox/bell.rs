//! Bells by iceoryx2 events.

use std::os::fd::BorrowedFd;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::*;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use sortie_core::link::{Clock, LinkError, Wake};
use sortie_core::wire::Role;

use super::open::Opener;
use super::services;
use crate::clock::MonotonicClock;
use crate::error::Error;

/// The own bell, and those of the peers.
pub(super) struct EventBell {
    listener: Listener<ipc::Service>,
    peers: Vec<(Role, Notifier<ipc::Service>)>,
}

impl EventBell {
    pub(super) fn new(opener: &Opener<'_>, own: Role, peers: &[Role]) -> Result<Self, Error> {
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
        Ok(Self { listener, peers })
    }

    pub(super) fn ring(&self, role: Role) -> Result<(), LinkError> {
        let notifiers = self.peers.iter().filter(|(peer, _)| *peer == role);
        for (_, notifier) in notifiers {
            notifier.notify().map_err(|_| LinkError::Bell)?;
        }
        Ok(())
    }

    /// Whether somebody rang; forgets it.
    fn drain(&self) -> bool {
        // A listener that fails is looked at again after the next heartbeat.
        self.listener.try_wait(|_| {}).is_ok_and(|rings| rings > 0)
    }

    pub(super) fn wait_until(&self, until_ns: u64) -> Wake {
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
        // Time-out, ring and signal need no telling apart: the topics are looked at in any case.
        let _ =
            poll(&mut [PollFd::from_borrowed_fd(self.descriptor(), PollFlags::IN)], Some(&timeout));
        if self.drain() { Wake::Rung } else { Wake::Timeout }
    }

    #[allow(unsafe_code)]
    fn descriptor(&self) -> BorrowedFd<'_> {
        let descriptor = self.listener.file_descriptor();
        // SAFETY: the listener owns the descriptor and keeps it open for as long as it lives; the
        // result borrows `self`, which owns the listener. It is neither stored nor closed here.
        unsafe { BorrowedFd::borrow_raw(descriptor.native_handle()) }
    }
}
