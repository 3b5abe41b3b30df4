//! An allocator process: one of a domain leads, the others stand by, ready to take over.

use sortie_core::Allocator;
use sortie_core::roles::{
    AllocatorError, AllocatorOptions, AllocatorRole, Counters, Identity, Poll,
};

use super::candidacy::Candidacy;
use super::parent::Parent;
use super::{ProcessSettings, WORLD_PATIENCE, Waits, drive};
use crate::domain::{Domain, DomainContract, Lock, Membership};
use crate::error::Error;
use crate::iox::{IoxAllocator, LinkSetup};
use crate::stop::Stop;
use crate::waker::Wakeable;

/// Allocates for `domain` with `allocator`, in this thread, until the world ends; stands by while
/// another allocator leads.
///
/// # Errors
/// No world comes, it runs another contract, `allocator` refuses a state, or a signal came.
pub fn allocator_process(
    domain: &Domain,
    contract: &DomainContract,
    allocator: &mut dyn Allocator,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    let parent = Parent::follow(settings.parent)?;
    let membership = domain.enter()?;
    let facts = membership.await_facts(contract, WORLD_PATIENCE, stop)?;
    settings.check_limits(facts.shape())?;
    let format = facts.format()?;
    let pid = std::process::id();
    let name = format!("allocator/{pid}");
    let mut link: IoxAllocator = {
        let _starting = membership.lock_start()?;
        let (bell, spin) = (facts.bell(), settings.spin);
        IoxAllocator::open(&LinkSetup { domain, format, name: &name, bell, spin })?
    };
    let mut role = AllocatorRole::new(AllocatorOptions {
        format,
        identity: Identity { model: settings.model, ..Identity::new(pid, &name) },
        decision_interval: contract.decision_interval,
    });
    role.join(&mut link)?;
    let mut waits = Waits::default();
    let mut leadership = Leadership::seek(&membership, &link)?;
    settings.real_time.claim()?;
    let poll = |link: &mut IoxAllocator| -> Result<Poll, Error> {
        leadership.follow(&mut role, &membership, link)?;
        role.poll(link, allocator).map_err(into_error)
    };
    let ended = drive(&mut link, stop, &mut waits, poll, || Parent::check(&parent));
    // Whoever takes over finds this one gone.
    let left = role.leave(&mut link).map_err(Error::from);
    ended.and(left).map(|()| waits.add_to(*role.counters()))
}

/// Whether this process may lead, which the kernel decides.
enum Leadership {
    /// Another process leads, or nobody yet.
    Sought(Candidacy),
    /// This one leads for as long as it keeps the lock.
    Held { _lock: Lock },
}

impl Leadership {
    fn seek(membership: &Membership, link: &impl Wakeable) -> Result<Self, Error> {
        Candidacy::start(membership.wait_to_lead_allocators(), link.waker()).map(Self::Sought)
    }

    /// Tells the role that it leads; lets the lock go where the role has stepped down.
    fn follow(
        &mut self,
        role: &mut AllocatorRole,
        membership: &Membership,
        link: &impl Wakeable,
    ) -> Result<(), Error> {
        match self {
            Self::Sought(candidacy) => {
                if let Some(lock) = candidacy.take()? {
                    role.lead(lock.term());
                    *self = Self::Held { _lock: lock };
                }
            }
            Self::Held { .. } if role.term().is_none() => *self = Self::seek(membership, link)?,
            Self::Held { .. } => {}
        }
        Ok(())
    }
}

pub(crate) fn into_error(error: AllocatorError) -> Error {
    match error {
        AllocatorError::Link(error) => Error::Link(error),
        other => Error::Allocator(other),
    }
}
