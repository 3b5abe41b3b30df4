//! The doorbell: how processes of a domain wake each other, by counters in shared memory on which
//! the kernel lets them sleep. A ring is one system call where somebody sleeps, else none.
//!
//! Rules for its users: the token is taken before looking at the topics; data is sent before the
//! ring; after every wake all topics are looked at; every wait has a deadline of at most 100 ms.

mod algorithm;
mod region;

use std::sync::Arc;
use std::time::Duration;

use sortie_core::link::{LinkError, Wake};
use sortie_core::wire::Role;

use algorithm::summon;
pub(crate) use algorithm::{Memory, Wait, ring, wait};

use self::region::Region;
use crate::domain::Domain;
use crate::error::Error;
use crate::waker::Waker;

/// One process's end of its domain's doorbell.
#[derive(Clone, Debug)]
pub struct Doorbell {
    region: Arc<Region>,
    own: usize,
    spin_ns: u64,
}

impl Doorbell {
    /// Opens the doorbell of a domain that this process has entered, to be woken with its role.
    /// Waits spin for `spin` before they sleep.
    ///
    /// # Errors
    /// Shared memory cannot be used, or the role has no bell.
    pub fn open(domain: &Domain, own: Role, spin: Duration) -> Result<Self, Error> {
        let own = index(own).ok_or_else(|| Error::SharedMemory {
            what: format!("bell of {own:?}"),
            problem: "this role has none".to_string(),
        })?;
        let spin_ns = u64::try_from(spin.as_nanos()).unwrap_or(u64::MAX);
        Ok(Self { region: Arc::new(Region::open(domain)?), own, spin_ns })
    }

    /// The state of the own bell.
    pub fn token(&self) -> u32 {
        self.region.bell(self.own).map_or(0, Memory::sequence)
    }

    /// Waits until somebody rang the own bell since `token` was taken, or until `until_ns`.
    pub fn wait_until(&self, token: u32, until_ns: u64) -> Wake {
        self.wait_for_rings(token, 1, until_ns)
    }

    /// Waits until the own bell was rung so often since `token` was taken, or until `until_ns`. Of
    /// the processes of one role, one may wait for more than one ring.
    pub fn wait_for_rings(&self, token: u32, rings: u32, until_ns: u64) -> Wake {
        let awaited = Wait { token, rings, until_ns, spin_ns: self.spin_ns };
        let is_rung = |bell| wait(bell, awaited);
        if self.region.bell(self.own).is_some_and(is_rung) { Wake::Rung } else { Wake::Timeout }
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
