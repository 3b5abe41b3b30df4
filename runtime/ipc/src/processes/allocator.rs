//! An allocator process: one of a domain leads, the others stand by, ready to take over.

use std::time::Duration;

use sortie_core::Allocator;
use sortie_core::roles::{
    AllocatorError, AllocatorOptions, AllocatorRole, Counters, Identity, Poll,
};
use sortie_core::wire::{Command, ControlStatus, Role};

use super::candidacy::Candidacy;
use super::control::Controlled;
use super::parent::Parent;
use super::{Process, ProcessSettings, WORLD_PATIENCE, drive};
use crate::control::ProcessInfo;
use crate::domain::{Domain, DomainContract, Lock, Membership};
use crate::error::Error;
use crate::iox::{IoxAllocator, LinkSetup};
use crate::stop::Stop;
use crate::waker::Wakeable;

/// How long an allocator that has stepped down leaves the lead to others.
const REST: Duration = Duration::from_millis(500);

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
    let name = format!("allocator/{}", std::process::id());
    let mut link: IoxAllocator = {
        let _starting = membership.lock_start()?;
        let (bell, spin) = (facts.bell(), settings.spin);
        IoxAllocator::open(&LinkSetup { domain, format, name: &name, bell, spin })?
    };
    let identity = settings.identity(&name);
    let mut role = AllocatorRole::new(AllocatorOptions {
        format,
        identity,
        decision_interval: contract.decision_interval,
    });
    role.join(&mut link)?;
    let leadership = Leadership::seek(&membership, &link, Duration::ZERO)?;
    let schema = format.schema;
    let membership = &membership;
    let mut allocating =
        Allocating { role, allocator, leadership, membership, parent, identity, schema };
    settings.real_time.claim()?;
    let ended = drive(&mut allocating, &mut link, stop);
    // Whoever takes over finds this one gone.
    let left = allocating.role.leave(&mut link).map_err(Error::from);
    ended.and(left).map(|()| *allocating.role.counters())
}

/// An allocator at work.
struct Allocating<'a> {
    role: AllocatorRole,
    allocator: &'a mut dyn Allocator,
    leadership: Leadership,
    membership: &'a Membership,
    parent: Option<Parent>,
    identity: Identity,
    schema: u64,
}

impl Process for Allocating<'_> {
    type Link = IoxAllocator;

    fn poll(&mut self, link: &mut IoxAllocator) -> Result<Poll, Error> {
        self.leadership.follow(&mut self.role, self.membership, link)?;
        self.role.poll(link, self.allocator).map_err(into_error)
    }

    fn look_around(&mut self) -> Result<(), Error> {
        Parent::check(&self.parent)
    }
}

impl Controlled for Allocating<'_> {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.role.tick()
    }

    fn info(&self) -> ProcessInfo {
        let info = ProcessInfo::new(Role::Allocator, &self.identity);
        ProcessInfo { term: self.role.term(), ..info }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        self.role.counters_mut()
    }

    fn obey(&mut self, command: Command) -> ControlStatus {
        match command {
            Command::StepDown if self.role.term().is_some() => {
                self.role.stand_by();
                ControlStatus::Done
            }
            // It has no registry to load from: whoever starts it gives it the rules.
            Command::ReloadModel => ControlStatus::NotSupported,
            _ => ControlStatus::NotMine,
        }
    }
}

/// Whether this process may lead, which the kernel decides.
enum Leadership {
    /// Another process leads, or nobody yet.
    Sought(Candidacy),
    /// This one leads for as long as it keeps the lock.
    Held { _lock: Lock },
}

impl Leadership {
    fn seek(membership: &Membership, link: &impl Wakeable, after: Duration) -> Result<Self, Error> {
        let wait = membership.wait_to_lead_allocators();
        Candidacy::start(wait, after, link.waker()).map(Self::Sought)
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
            // The lock is let go here, and long before this one wants it again.
            Self::Held { .. } if role.term().is_none() => {
                *self = Self::seek(membership, link, REST)?;
            }
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
