//! Entering and leaving a domain by locks that the kernel frees when their holder dies, however it dies; the last one out
//! removes everything.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::time::Duration;

use sortie_core::limits;
use sortie_core::wire::Role;

use super::facts::{self, DomainContract, DomainFacts};
use super::objects::{ignore_missing, remove};
use super::{Domain, preflight};
use crate::error::Error;
use crate::stop::Stop;

/// Exclusive around every start and every leave.
const STARTING: &str = "init.lock";
/// Shared by every process for its life.
const ALIVE: &str = "alive.lock";
/// Held by the world.
const WORLD: &str = "world.lock";

/// The lock of an agent's seat.
fn seat(agent: u16) -> String {
    format!("agent-{agent}.lock")
}

/// A process's part in a domain, for its life.
#[derive(Debug)]
pub struct Membership {
    domain: Domain,
    alive: File,
}

/// Only one process of a domain starts at a time: it holds this.
#[derive(Debug)]
pub struct Starting {
    _lock: File,
}

impl Domain {
    /// Enters the domain. If nobody is in it, what dead processes left is removed first.
    ///
    /// # Errors
    /// The domain's directory cannot be used, or other users may open one of its objects.
    pub fn enter(&self) -> Result<Membership, Error> {
        preflight::check_descriptors()?;
        preflight::check_path_length(self)?;
        if let Some(existing) = self.base().ancestors().find(|path| path.exists()) {
            preflight::check_tmpfs(existing)?;
        }
        let _starting = self.lock_start()?;
        let path = self.path(ALIVE);
        let alive = open_lock(&path)?;
        if alive.try_lock().is_ok() {
            self.remove_leftovers()?;
            alive.unlock().map_err(Error::io("unlock", &path))?;
        } else {
            // Of a process that was killed before it could.
            self.close_node_numbers()?;
            self.check_objects()?;
        }
        // Nobody can take it exclusively in between: that needs the start lock.
        alive.lock_shared().map_err(Error::io("lock", &path))?;
        Ok(Membership { domain: self.clone(), alive })
    }

    /// Creates the directory and waits for the start lock. A domain that is removed meanwhile is
    /// created again.
    fn lock_start(&self) -> Result<Starting, Error> {
        loop {
            preflight::create_directory(self)?;
            if let Some(file) = wait_for_lock(&self.path(STARTING))? {
                return Ok(Starting { _lock: file });
            }
        }
    }

    /// Whether a process of the domain lives. Creates nothing.
    ///
    /// # Errors
    /// A lock of the domain cannot be used.
    pub fn is_alive(&self) -> Result<bool, Error> {
        // Whoever starts looks at the same lock under this one.
        let starting = self.path(STARTING);
        let Some(_starting) = wait_to_lock(&starting, existing_lock(&starting)?)? else {
            return Ok(false);
        };
        let alive = existing_lock(&self.path(ALIVE))?;
        Ok(alive.is_some_and(|alive| alive.try_lock().is_err()))
    }

    /// What the domain is, where a process of it lives and a world has stated it. Creates nothing.
    ///
    /// # Errors
    /// A file of the domain cannot be used.
    pub fn facts(&self) -> Result<Option<DomainFacts>, Error> {
        if self.is_alive()? { facts::read(self) } else { Ok(None) }
    }

    /// Removes what only processes that live could use.
    fn remove_leftovers(&self) -> Result<(), Error> {
        let root = self.iox_root();
        ignore_missing(fs::remove_dir_all(&root)).map_err(Error::io("remove", &root))?;
        for entry in fs::read_dir(self.base()).map_err(Error::io("list", self.base()))? {
            let path = entry.map_err(Error::io("list", self.base()))?.path();
            let is_lock = path.file_name().is_some_and(|name| name == STARTING || name == ALIVE);
            if !is_lock {
                remove(&path)?;
            }
        }
        self.remove_shared_memory()
    }
}

impl Membership {
    /// The domain.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// Keeps other processes of the domain from starting, while this one creates its services.
    ///
    /// # Errors
    /// The lock cannot be used.
    pub fn lock_start(&self) -> Result<Starting, Error> {
        self.domain.lock_start()
    }

    /// Takes the world's role, and states what the domain is.
    ///
    /// # Errors
    /// Another world runs, runners of another contract wait, or shared memory has no room for
    /// `bytes`.
    pub fn lead_world(
        &self,
        contract: &DomainContract,
        facts: &DomainFacts,
        bytes: u64,
    ) -> Result<Lock, Error> {
        let lock = self.take(WORLD, "the world")?;
        preflight::check_space(bytes)?;
        if !self.check_world(contract, facts)? {
            facts::write(&self.domain, facts)?;
        }
        Ok(lock)
    }

    /// States anew which bundles the team has: the world does, before a frame asks for one.
    pub(crate) fn state(&self, facts: &DomainFacts) -> Result<(), Error> {
        facts::write(&self.domain, facts)
    }

    /// Takes the right to change the team's bundle, which one process has at a time.
    ///
    /// # Errors
    /// Another process changes it.
    pub(crate) fn lead_swap(&self) -> Result<Lock, Error> {
        self.take("swap.lock", "the change of its bundle")
    }

    /// Checks that a world of `contract` and `ours` fits what the domain is, if a world has stated that already.
    /// Returns whether one has.
    ///
    /// # Errors
    /// Another contract, another team, or another kind of world.
    pub fn check_world(
        &self,
        contract: &DomainContract,
        ours: &DomainFacts,
    ) -> Result<bool, Error> {
        let Some(stated) = self.facts()? else { return Ok(false) };
        stated.check(&self.domain, contract)?;
        stated.check_world(&self.domain, ours)?;
        Ok(true)
    }

    /// Whether a world lives: the kernel frees its lock when it dies, however it dies.
    pub(crate) fn has_world(&self) -> Result<bool, Error> {
        self.holder(WORLD).map(|holder| holder.is_some())
    }

    /// The process that is the world, or acts for one of the agents (bit a: agent a), if there is one; 0 = unknown.
    /// Other roles may be held by several.
    pub(crate) fn holder_of(&self, role: Role, agents: u64) -> Result<Option<u64>, Error> {
        match role {
            Role::World => self.holder(WORLD),
            Role::Runner => {
                let seats = (0..limits::AGENTS as u16).filter(|agent| agents >> agent & 1 == 1);
                let mut holders = seats.map(|agent| self.holder(&seat(agent)));
                holders.find_map(Result::transpose).transpose()
            }
            _ => Ok(None),
        }
    }

    /// The process that holds a lock of the domain.
    fn holder(&self, name: &str) -> Result<Option<u64>, Error> {
        let path = self.domain.path(name);
        // Whoever takes a role does so under this lock, and never meets the one below.
        let _starting = self.lock_start()?;
        let Some(mut file) = existing_lock(&path)? else { return Ok(None) };
        match file.try_lock_shared() {
            Ok(()) => Ok(None),
            Err(TryLockError::WouldBlock) => {
                read_term(&mut file).map(|[_, pid]| Some(pid)).map_err(Error::io("read", &path))
            }
            Err(TryLockError::Error(error)) => Err(Error::io("lock", &path)(error)),
        }
    }

    /// What waits until this process leads the allocators of the domain, or no longer wants to.
    pub(crate) fn wait_to_lead_allocators(
        &self,
    ) -> impl FnOnce(&dyn Fn() -> bool) -> Result<Option<Lock>, Error> + Send + use<> {
        let path = self.domain.path("allocator.lock");
        move |is_wanted| Lock::wait(&path, is_wanted)
    }

    /// Takes the seat of `agent`.
    ///
    /// # Errors
    /// Another process acts for the agent.
    pub fn take_seat(&self, agent: u16) -> Result<Lock, Error> {
        self.take(&seat(agent), &format!("agent {agent}"))
    }

    /// Takes one end of a served policy.
    ///
    /// # Errors
    /// Another process has it, or shared memory has no room for `bytes`.
    pub(crate) fn take_end(&self, file: &str, what: &str, bytes: u64) -> Result<Lock, Error> {
        let lock = self.take(file, what)?;
        preflight::check_space(bytes)?;
        Ok(lock)
    }

    fn take(&self, file: &str, what: &str) -> Result<Lock, Error> {
        let _starting = self.lock_start()?;
        Lock::take(&self.domain.path(file))?.map_err(|pid| Error::Busy {
            what: what.to_string(),
            domain: self.domain.id().to_string(),
            pid,
        })
    }

    /// Waits for a world to state what the domain is, and checks that `contract` fits it.
    ///
    /// # Errors
    /// No world in time, another contract, or interrupted.
    pub fn await_facts(
        &self,
        contract: &DomainContract,
        patience: Duration,
        stop: &Stop,
    ) -> Result<DomainFacts, Error> {
        let facts = facts::wait_for(&self.domain, patience, stop)?;
        facts.check(&self.domain, contract)?;
        Ok(facts)
    }

    /// What the domain is, once a world has stated it.
    ///
    /// # Errors
    /// The file that states it cannot be read.
    pub fn facts(&self) -> Result<Option<DomainFacts>, Error> {
        facts::read(&self.domain)
    }

    fn leave(&self) -> Result<(), Error> {
        let path = self.domain.path(ALIVE);
        let _starting = self.domain.lock_start()?;
        self.alive.unlock().map_err(Error::io("unlock", &path))?;
        if self.alive.try_lock().is_err() {
            return Ok(());
        }
        self.domain.remove_shared_memory()?;
        let base = self.domain.base();
        fs::remove_dir_all(base).map_err(Error::io("remove", base))?;
        if let Some(parent) = self.domain.own_parent() {
            // Fails where other domains live there too, as it should.
            let _ = fs::remove_dir(parent);
        }
        Ok(())
    }
}

impl Drop for Membership {
    /// Leaves; the last one out removes everything. What fails here is removed by the next start.
    fn drop(&mut self) {
        let _ = self.leave();
    }
}

/// An exclusive lock on one role. Its file holds the last term and the holder's process id.
#[derive(Debug)]
pub struct Lock {
    file: File,
    term: u32,
}

impl Lock {
    /// Takes the lock and raises its term.
    ///
    /// # Errors
    /// `Err(Ok(pid))` where another process holds it.
    pub(super) fn take(path: &Path) -> Result<Result<Self, u64>, Error> {
        let mut file = open_lock(path)?;
        match file.try_lock() {
            Ok(()) => Self::raise_term(file, path).map(Ok),
            Err(TryLockError::WouldBlock) => {
                let [_, pid] = read_term(&mut file).map_err(Error::io("read", path))?;
                Ok(Err(pid))
            }
            Err(TryLockError::Error(error)) => Err(Error::io("lock", path)(error)),
        }
    }

    /// Waits for the lock, and raises its term if it is wanted then; `None` if not.
    pub(super) fn wait(path: &Path, is_wanted: &dyn Fn() -> bool) -> Result<Option<Self>, Error> {
        let file = open_lock(path)?;
        loop {
            match file.lock() {
                Ok(()) if is_wanted() => return Self::raise_term(file, path).map(Some),
                Ok(()) => return Ok(None),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Error::io("lock", path)(error)),
            }
        }
    }

    fn raise_term(mut file: File, path: &Path) -> Result<Self, Error> {
        let [last_term, _] = read_term(&mut file).map_err(Error::io("read", path))?;
        let term = (last_term as u32).wrapping_add(1).max(1);
        let pid = u64::from(std::process::id());
        write_term(&mut file, [u64::from(term), pid]).map_err(Error::io("write", path))?;
        Ok(Self { file, term })
    }

    /// The term of this leadership: larger than all before, from 1.
    pub fn term(&self) -> u32 {
        self.term
    }
}

impl Drop for Lock {
    /// A process that is being started has the file open too until it runs its program: closed alone, it would be locked
    /// until then.
    fn drop(&mut self) {
        let _ = self.file.unlock();
    }
}

/// Opens a lock file, creating it for its user only.
fn open_lock(path: &Path) -> Result<File, Error> {
    create_lock(path).map_err(Error::io("open", path))
}

fn create_lock(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o600).open(path)
}

/// Locks `path` exclusively, waiting for it. `None` if the file was removed meanwhile: a domain
/// was purged, and its lock means nothing any more.
fn wait_for_lock(path: &Path) -> Result<Option<File>, Error> {
    wait_to_lock(path, found(path, create_lock(path))?)
}

/// Opens a lock file, if there is one.
fn existing_lock(path: &Path) -> Result<Option<File>, Error> {
    found(path, OpenOptions::new().read(true).write(true).open(path))
}

fn found(path: &Path, opened: io::Result<File>) -> Result<Option<File>, Error> {
    match opened {
        Ok(file) => Ok(Some(file)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Error::io("open", path)(error)),
    }
}

fn wait_to_lock(path: &Path, file: Option<File>) -> Result<Option<File>, Error> {
    let Some(file) = file else { return Ok(None) };
    file.lock().map_err(Error::io("lock", path))?;
    let locked = file.metadata().map_err(Error::io("look at", path))?;
    let is_same = path.metadata().is_ok_and(|now| now.ino() == locked.ino());
    Ok(is_same.then_some(file))
}

/// The two numbers of a lock file; zeros where it is new.
fn read_term(file: &mut File) -> io::Result<[u64; 2]> {
    let mut bytes = Vec::new();
    file.rewind()?;
    file.take(16).read_to_end(&mut bytes)?;
    let mut numbers = bytes
        .chunks_exact(8)
        .map(|chunk| chunk.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte)));
    Ok([numbers.next().unwrap_or(0), numbers.next().unwrap_or(0)])
}

fn write_term(file: &mut File, [term, pid]: [u64; 2]) -> io::Result<()> {
    file.rewind()?;
    file.write_all(&term.to_le_bytes())?;
    file.write_all(&pid.to_le_bytes())
}
