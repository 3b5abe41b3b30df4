//! The doorbell: how processes of a domain wake each other, by counters in shared memory on which
//! the kernel lets them sleep. A ring is one system call where somebody sleeps, else none.
//!
//! Rules for its users: the token is taken before looking at the topics; data is sent before the
//! ring; after every wake all topics are looked at; every wait has a deadline of at most 100 ms.

mod algorithm;
mod linger;
mod region;

use std::sync::Arc;
use std::time::Duration;

use sortie_core::link::{LinkError, Wake};
use sortie_core::wire::Role;

pub(crate) use algorithm::{Memory, Wait, ring, wait};
use algorithm::{linger, summon};

use self::linger::Account;
use self::region::Region;
use crate::domain::{Domain, nanoseconds};
use crate::error::Error;
use crate::waker::Waker;

/// One process's end of its domain's doorbell.
#[derive(Clone, Debug)]
pub struct Doorbell {
    region: Arc<Region>,
    own: usize,
    linger_ns: u64,
    account: Account,
}

impl Doorbell {
    /// Opens the doorbell of a domain that this process has entered, to be woken with its role.
    /// Waits linger for `linger` before they sleep, as long as that pays.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the role has no bell.
    pub fn open(domain: &Domain, own: Role, linger: Duration) -> Result<Self, Error> {
        let own = index(own).ok_or_else(|| Error::SharedMemory {
            what: format!("bell of {own:?}"),
            problem: "this role has none".to_string(),
        })?;
        Ok(Self {
            region: Arc::new(Region::open(domain)?),
            own,
            linger_ns: nanoseconds(linger),
            account: Account::new(),
        })
    }

    /// The state of the own bell.
    pub fn token(&self) -> u32 {
        self.region.bell(self.own).map_or(0, Memory::sequence)
    }

    /// Waits until somebody rang the own bell since `token` was taken, or until `until_ns`.
    pub fn wait_until(&self, token: u32, until_ns: u64) -> Wake {
        // A world that awaits no answers waits for a time.
        let linger_ns = if index(Role::World) == Some(self.own) { 0 } else { self.linger_ns };
        self.await_rings(Wait { token, rings: 1, until_ns }, linger_ns)
    }

    /// Waits until the own bell was rung so often since `token` was taken, or until `until_ns`. Of
    /// the processes of one role, one may wait for more than one ring.
    pub fn wait_for_rings(&self, token: u32, rings: u32, until_ns: u64) -> Wake {
        self.await_rings(Wait { token, rings, until_ns }, self.linger_ns)
    }

    fn await_rings(&self, awaited: Wait, linger_ns: u64) -> Wake {
        let Some(bell) = self.region.bell(self.own) else { return Wake::Timeout };
        if awaited.is_over(bell.sequence()) {
            return Wake::Rung;
        }
        if linger_ns != 0 && self.account.is_open(bell.now_ns()) {
            let lingered = linger(bell, awaited, linger_ns);
            self.account.enter(lingered, bell.now_ns());
        }
        if wait(bell, awaited) { Wake::Rung } else { Wake::Timeout }
    }

    /// Wakes every process of `role`.
    ///
    /// # Errors
    /// The role has no bell.
    pub fn ring(&self, role: Role) -> Result<(), LinkError> {
        let bell = index(role).and_then(|index| self.region.bell(index)).ok_or(LinkError::Bell)?;
        ring(bell);
        Ok(())
    }

    /// Wakes the processes of the own bell.
    pub(crate) fn waker(&self) -> Waker {
        let (region, own) = (Arc::clone(&self.region), self.own);
        Waker::new(move || {
            if let Some(bell) = region.bell(own) {
                summon(bell);
            }
        })
    }
}

/// The bell of a role.
fn index(role: Role) -> Option<usize> {
    match role {
        Role::World => Some(0),
        Role::Runner => Some(1),
        Role::Allocator => Some(2),
        Role::Watcher => Some(3),
        Role::Supervisor | Role::Bridge => None,
    }
}
