//! Entering and leaving a domain; the last one out removes everything.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::facts::{self, DomainContract, DomainFacts};
use super::{Domain, SHARED_MEMORY, lock, preflight};
use crate::Lock;
use crate::error::Error;
use crate::stop::Stop;

/// Exclusive around every start and every leave.
const STARTING: &str = "init.lock";
/// Shared by every process for its life.
const ALIVE: &str = "alive.lock";

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
    /// The domain's directory cannot be used.
    pub fn enter(&self) -> Result<Membership, Error> {
        preflight::check_descriptors()?;
        preflight::check_path_length(self)?;
        if let Some(existing) = self.base().ancestors().find(|path| path.exists()) {
            preflight::check_tmpfs(existing)?;
        }
        let _starting = self.lock_start()?;
        let path = self.path(ALIVE);
        let alive = lock::open(&path)?;
        if alive.try_lock().is_ok() {
            self.remove_leftovers()?;
            alive.unlock().map_err(Error::io("unlock", &path))?;
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
            if let Some(file) = lock::wait_for(&self.path(STARTING))? {
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
        let Some(_starting) = lock::wait_for_existing(&self.path(STARTING))? else {
            return Ok(false);
        };
        let alive = lock::existing(&self.path(ALIVE))?;
        Ok(alive.is_some_and(|alive| alive.try_lock().is_err()))
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

    fn remove_shared_memory(&self) -> Result<(), Error> {
        for path in self.shared_memory()? {
            remove(&path)?;
        }
        Ok(())
    }

    /// The domain's objects in shared memory.
    ///
    /// # Errors
    /// Shared memory cannot be listed.
    pub fn shared_memory(&self) -> Result<Vec<PathBuf>, Error> {
        let directory = Path::new(SHARED_MEMORY);
        let mut objects = Vec::new();
        for entry in fs::read_dir(directory).map_err(Error::io("list", directory))? {
            let entry = entry.map_err(Error::io("list", directory))?;
            if entry.file_name().to_str().is_some_and(|name| self.owns(name)) {
                objects.push(entry.path());
            }
        }
        Ok(objects)
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
        let lock = self.take("world.lock", "the world")?;
        preflight::check_space(bytes)?;
        match facts::read(&self.domain)? {
            Some(earlier) => {
                earlier.check(&self.domain, contract)?;
                earlier.check_world(&self.domain, contract, facts)?;
            }
            None => facts::write(&self.domain, facts)?,
        }
        Ok(lock)
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
        self.take(&format!("agent-{agent}.lock"), &format!("agent {agent}"))
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

    /// Checks that `contract` fits what the domain is, if a world has stated that already.
    ///
    /// # Errors
    /// Another contract, or another team.
    pub fn check(&self, contract: &DomainContract) -> Result<(), Error> {
        self.facts()?.map_or(Ok(()), |facts| facts.check(&self.domain, contract))
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

/// Removes whatever carries the domain's name, a folder as well.
fn remove(path: &Path) -> Result<(), Error> {
    let removed = match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::IsADirectory => fs::remove_dir_all(path),
        other => other,
    };
    ignore_missing(removed).map_err(Error::io("remove", path))
}

fn ignore_missing(result: io::Result<()>) -> io::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
