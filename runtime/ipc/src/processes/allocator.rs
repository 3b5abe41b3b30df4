//! An allocator process.

use sortie_core::Allocator;
use sortie_core::roles::{AllocatorError, AllocatorOptions, AllocatorRole, Counters, Identity};

use super::parent::Parent;
use super::{ProcessSettings, WORLD_PATIENCE, drive};
use crate::domain::{Domain, DomainContract};
use crate::error::Error;
use crate::iox::{IoxAllocator, LinkSetup};
use crate::stop::Stop;

/// Allocates for `domain` with `allocator`, in this thread, until the world ends.
///
/// # Errors
/// No world comes, it runs another contract, another allocator leads, `allocator` refuses a state,
/// or a signal came.
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
    let lock = membership.lead_allocator()?;
    let format = facts.format()?;
    let pid = std::process::id();
    let name = format!("allocator/{pid}");
    let mut link = {
        let _starting = membership.lock_start()?;
        IoxAllocator::open(&LinkSetup { domain, format, name: &name })?
    };
    let mut role = AllocatorRole::new(AllocatorOptions {
        format,
        identity: Identity { model: settings.model, ..Identity::new(pid, &name) },
        decision_interval: contract.decision_interval,
    });
    role.lead(lock.term());
    role.join(&mut link)?;
    let poll = |link: &mut IoxAllocator| role.poll(link, allocator).map_err(into_error);
    let ended = drive(&mut link, stop, poll, || Parent::check(&parent));
    let left = role.leave(&mut link).map_err(Error::from);
    ended.and(left).map(|()| *role.counters())
}

pub(crate) fn into_error(error: AllocatorError) -> Error {
    match error {
        AllocatorError::Link(error) => Error::Link(error),
        other => Error::Allocator(other),
    }
}
