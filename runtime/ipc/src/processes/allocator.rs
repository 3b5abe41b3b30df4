//! An allocator process: one of a domain leads, the others stand by, ready to take over.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sortie_core::roles::{
    AllocatorError, AllocatorOptions, AllocatorRole, Counters, Identity, Poll,
};
use sortie_core::wire::{Command, ControlReq, ControlStatus, Role};
use sortie_core::{Allocator, Shape};

use super::abandoned::Abandoned;
use super::children::Parent;
use super::models::{Held, Models, Registry};
use super::{
    Controlled, FAR_SIGNAL_PATIENCE, Process, ProcessSettings, WORLD_PATIENCE, drive, is_named,
};
use crate::domain::{Domain, DomainContract, DomainFacts, Lock, Membership};
use crate::error::Error;
use crate::iox::{IoxAllocator, LinkSetup};
use crate::process_info::ProcessInfo;
use crate::stop::{Stop, Wakeable, Waker};

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
    let mut process = AllocatorProcess::join(domain, contract, settings, stop)?;
    let ended = process.allocate(allocator, None, stop);
    let left = process.leave();
    ended.and(left)
}

/// An allocator that a team changes to: whole, and ready to allocate.
pub type SwappedAllocator = Box<dyn Allocator + Send>;

/// An allocator that has joined its domain.
pub struct AllocatorProcess {
    link: IoxAllocator,
    role: AllocatorRole,
    leadership: Leadership,
    parent: Option<Parent>,
    identity: Identity,
    schema: u64,
    contract: u64,
    mixes_teams: bool,
    shape: Shape,
    abandoned: Abandoned,
    /// Dropped last.
    membership: Membership,
}

impl AllocatorProcess {
    /// Joins `domain`, and stands by until the lead is free.
    ///
    /// # Errors
    /// No world comes, it runs another contract, or a signal came.
    pub fn join(
        domain: &Domain,
        contract: &DomainContract,
        settings: &ProcessSettings,
        stop: &Stop,
    ) -> Result<Self, Error> {
        let parent = Parent::follow(settings.parent)?;
        let membership = domain.enter()?;
        let facts = membership.await_facts(contract, WORLD_PATIENCE, stop)?;
        let shape = facts.shape();
        settings.check_limits(shape)?;
        let format = facts.format()?;
        let name = format!("allocator/{}", std::process::id());
        let mut link: IoxAllocator = {
            let _starting = membership.lock_start()?;
            // Many ticks pass from one allocation to the next.
            let (bell, linger) = (facts.bell(), Duration::ZERO);
            IoxAllocator::open(&LinkSetup { domain, format, name: &name, bell, linger })?
        };
        let identity = settings.identity(&name);
        let mut role = AllocatorRole::new(AllocatorOptions {
            format,
            identity,
            decision_interval: contract.decision_interval,
        });
        role.join(&mut link)?;
        settings.real_time.claim()?;
        let (schema, mixes_teams) = (format.schema, contract.mixes_teams);
        let contract = contract.hash;
        Ok(Self {
            link,
            role,
            leadership: Leadership::Left,
            parent,
            identity,
            schema,
            contract,
            mixes_teams,
            shape,
            abandoned: Abandoned::new(settings.world_patience),
            membership,
        })
    }

    /// Allocates with `allocator`, in this thread, until the world ends; and with those that the team changes to, which
    /// `registry` opens.
    ///
    /// # Errors
    /// `allocator` refuses a state, the link failed, or a signal came.
    pub fn allocate(
        &mut self,
        allocator: &mut dyn Allocator,
        registry: Option<Registry<SwappedAllocator>>,
        stop: &Stop,
    ) -> Result<(), Error> {
        self.run(allocator, registry, (&|| true, Duration::ZERO), stop)
    }

    /// As [`Self::allocate`] with one allocator, for as long as it may lead: otherwise, and where it refuses a state because it may
    /// not any more, others do.
    pub(super) fn allocate_while(
        &mut self,
        may_lead: &dyn Fn() -> bool,
        allocator: &mut dyn Allocator,
        stop: &Stop,
    ) -> Result<(), Error> {
        self.run(allocator, None, (may_lead, FAR_SIGNAL_PATIENCE), stop)
    }

    /// What its domain is.
    pub(super) fn facts(&self) -> Result<DomainFacts, Error> {
        let none = || Error::NoWorld { domain: self.membership.domain().id().to_owned() };
        self.membership.facts()?.ok_or_else(none)
    }

    /// What wakes it.
    pub(super) fn waker(&self) -> Waker {
        self.link.waker()
    }

    fn run(
        &mut self,
        allocator: &mut dyn Allocator,
        registry: Option<Registry<SwappedAllocator>>,
        (may_lead, signal_patience): (&dyn Fn() -> bool, Duration),
        stop: &Stop,
    ) -> Result<(), Error> {
        let schema = self.schema;
        let Self { link, role, leadership, parent, identity, abandoned, membership, .. } = self;
        let model = Box::new(allocator) as Box<dyn Allocator + '_>;
        let own = Held { id: identity.model, model };
        let domain = (self.contract, self.shape);
        let mut models = Models::new(own, registry, |rules| rules, domain, link.waker());
        if let Some(facts) = membership.facts()? {
            models.join(facts.bundles(), self.mixes_teams);
        }
        let mut allocating = Allocating {
            role,
            models,
            leadership,
            membership,
            parent,
            abandoned,
            identity,
            schema,
            may_lead,
            signal_patience,
            is_told_to_end: false,
        };
        drive(&mut allocating, link, stop)
    }

    /// Says goodbye. Whoever takes over finds this one gone.
    ///
    /// # Errors
    /// The link failed.
    pub fn leave(mut self) -> Result<Counters, Error> {
        self.role.leave(&mut self.link)?;
        Ok(*self.role.counters())
    }
}

struct Allocating<'a, 'm> {
    role: &'a mut AllocatorRole,
    models: Models<Box<dyn Allocator + 'm>, SwappedAllocator>,
    leadership: &'a mut Leadership,
    membership: &'a Membership,
    parent: &'a Option<Parent>,
    abandoned: &'a mut Abandoned,
    identity: &'a mut Identity,
    schema: u64,
    may_lead: &'a dyn Fn() -> bool,
    signal_patience: Duration,
    is_told_to_end: bool,
}

impl Process for Allocating<'_, '_> {
    type Link = IoxAllocator;

    fn poll(&mut self, link: &mut IoxAllocator) -> Result<Poll, Error> {
        self.leadership.follow(self.role, self.membership, link, (self.may_lead)())?;
        let Self { role, models, identity, .. } = self;
        role.receive(link)?;
        if let Some(model) = models.follow(role.asked_generation(link), identity) {
            role.change_model(model);
        }
        match models.in_use() {
            Some(allocator) => match role.answer(link, allocator.as_mut()) {
                // Others are asked about that frame, at once.
                Err(AllocatorError::Refused { .. }) if !(self.may_lead)() => {
                    self.leadership.follow(role, self.membership, link, false)?;
                    Ok(Poll::Again)
                }
                answered => answered.map_err(into_error),
            },
            // Agents go on with the allocation that they have until its bundle has been opened.
            None => Ok(Poll::Wait { until_ns: u64::MAX }),
        }
    }

    fn leaves_loop(&self) -> bool {
        self.is_told_to_end
    }

    fn signal_patience(&self) -> Duration {
        self.signal_patience
    }

    fn look_around(&mut self) -> Result<(), Error> {
        Parent::check(self.parent)?;
        self.models.catch_up(self.membership)?;
        self.abandoned.check(self.membership, self.role.tick())
    }
}

impl Controlled for Allocating<'_, '_> {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.role.tick()
    }

    fn info(&self) -> ProcessInfo {
        let info = ProcessInfo::new(Role::Allocator, self.identity);
        let (generation, candidate) = (self.models.generation(), self.models.candidate());
        ProcessInfo { term: self.role.term(), generation, candidate, ..info }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        self.role.counters_mut()
    }

    fn obey(&mut self, command: Command, request: &ControlReq) -> ControlStatus {
        match command {
            Command::ShutDown if is_named(request) => {
                self.is_told_to_end = true;
                ControlStatus::Done
            }
            Command::StepDown if self.role.term().is_some() => {
                self.role.stand_by();
                ControlStatus::Done
            }
            Command::PrepareBundle => self.models.prepare(request.text(), request.arg64 as u16),
            _ => ControlStatus::NotMine,
        }
    }
}

/// Whether this process may lead, which the kernel decides.
enum Leadership {
    /// Left to others.
    Left,
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

    /// Tells the role that it leads; lets the lock go where the role has stepped down, or may not lead.
    fn follow(
        &mut self,
        role: &mut AllocatorRole,
        membership: &Membership,
        link: &impl Wakeable,
        may_lead: bool,
    ) -> Result<(), Error> {
        match self {
            Self::Left if may_lead => *self = Self::seek(membership, link, Duration::ZERO)?,
            Self::Left => {}
            _ if !may_lead => {
                role.stand_by();
                *self = Self::Left;
            }
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

/// A process that waits for a lock on a thread of its own: the kernel hands the lock on the moment that its holder dies,
/// however it dies. Dropped, it no longer wants it: the thread stays behind until the lock comes, and lets it go at once.
struct Candidacy {
    shared: Arc<Shared>,
}

struct Shared {
    is_withdrawn: AtomicBool,
    outcome: Mutex<Option<Result<Lock, Error>>>,
}

impl Candidacy {
    /// Calls `wait_for_lock` on a thread, after a rest; `waker` tells when there is something to [`Self::take`].
    fn start(
        wait_for_lock: impl FnOnce(&dyn Fn() -> bool) -> Result<Option<Lock>, Error> + Send + 'static,
        rest: Duration,
        waker: Waker,
    ) -> Result<Self, Error> {
        let shared =
            Arc::new(Shared { is_withdrawn: AtomicBool::new(false), outcome: Mutex::new(None) });
        let waiting = Arc::clone(&shared);
        let wait = move || {
            let is_wanted = || !waiting.is_withdrawn.load(Ordering::SeqCst);
            std::thread::sleep(rest);
            if !is_wanted() {
                return;
            }
            if let Some(outcome) = wait_for_lock(&is_wanted).transpose() {
                let mut told = waiting.outcome();
                // Under the guard: a withdrawal comes before, or empties it after.
                *told = is_wanted().then_some(outcome);
                drop(told);
                waker.wake();
            }
        };
        let builder = std::thread::Builder::new().name("candidacy".into());
        builder.spawn(wait).map_err(Error::io("start", "candidacy"))?;
        Ok(Self { shared })
    }

    /// The lock, once.
    fn take(&self) -> Result<Option<Lock>, Error> {
        self.shared.outcome().take().transpose()
    }
}

impl Drop for Candidacy {
    fn drop(&mut self) {
        self.shared.is_withdrawn.store(true, Ordering::SeqCst);
        self.shared.outcome().take();
    }
}

impl Shared {
    /// What is stored is whole at any time, so a panic elsewhere spoils nothing.
    fn outcome(&self) -> MutexGuard<'_, Option<Result<Lock, Error>>> {
        self.outcome.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
