//! Locks that the kernel frees when their holder dies, however it dies.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

use crate::error::Error;

/// An exclusive lock on one role. Its file holds the last term and the holder's process id.
#[derive(Debug)]
pub struct Lock {
    _file: File,
    term: u32,
}

impl Lock {
    /// Takes the lock and raises its term.
    ///
    /// # Errors
    /// `Err(Ok(pid))` where another process holds it.
    pub(super) fn take(path: &Path) -> Result<Result<Self, u64>, Error> {
        let mut file = open(path)?;
        match file.try_lock() {
            Ok(()) => Self::raise_term(file, path).map(Ok),
            Err(TryLockError::WouldBlock) => {
                let [_, pid] = read(&mut file).map_err(Error::io("read", path))?;
                Ok(Err(pid))
            }
            Err(TryLockError::Error(error)) => Err(Error::io("lock", path)(error)),
        }
    }

    /// Waits for the lock, and raises its term if it is wanted then; `None` if not.
    pub(super) fn wait(path: &Path, is_wanted: &dyn Fn() -> bool) -> Result<Option<Self>, Error> {
        let file = open(path)?;
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
        let [last_term, _] = read(&mut file).map_err(Error::io("read", path))?;
        let term = (last_term as u32).wrapping_add(1).max(1);
        let pid = u64::from(std::process::id());
        write(&mut file, [u64::from(term), pid]).map_err(Error::io("write", path))?;
        Ok(Self { _file: file, term })
    }

    /// The term of this leadership: larger than all before, from 1.
    pub fn term(&self) -> u32 {
        self.term
    }
}

/// Opens a lock file, creating it for its user only.
pub(super) fn open(path: &Path) -> Result<File, Error> {
    create(path).map_err(Error::io("open", path))
}

fn create(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o600).open(path)
}

/// Locks `path` exclusively, waiting for it. `None` if the file was removed meanwhile: a domain
/// was purged, and its lock means nothing any more.
pub(super) fn wait_for(path: &Path) -> Result<Option<File>, Error> {
    wait_to_lock(path, found(path, create(path))?)
}

/// The same without creating the file: `None` if there is none.
pub(super) fn wait_for_existing(path: &Path) -> Result<Option<File>, Error> {
    wait_to_lock(path, existing(path)?)
}

/// Opens a lock file, if there is one.
pub(super) fn existing(path: &Path) -> Result<Option<File>, Error> {
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
fn read(file: &mut File) -> io::Result<[u64; 2]> {
    let mut bytes = Vec::new();
    file.rewind()?;
    file.take(16).read_to_end(&mut bytes)?;
    let mut numbers = bytes
        .chunks_exact(8)
        .map(|chunk| chunk.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte)));
    Ok([numbers.next().unwrap_or(0), numbers.next().unwrap_or(0)])
}

fn write(file: &mut File, [term, pid]: [u64; 2]) -> io::Result<()> {
    file.rewind()?;
    file.write_all(&term.to_le_bytes())?;
    file.write_all(&pid.to_le_bytes())
}
