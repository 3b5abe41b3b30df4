//! The domain's objects in shared memory: nobody but its user may open them.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

use super::preflight::{OTHERS, check_not_full};
use super::{Domain, SHARED_MEMORY};
use crate::error::Error;

/// End of the name of the one object that iceoryx2 opens to every user of the host, whatever the umask: 16 bytes, from
/// which each new node takes its number, and lets go of them.
const NODE_NUMBERS: &str = ".global_mgmt";
/// What may carry the domain's name only for as long as it is written.
const UNFINISHED: &str = ".new";
/// Bytes of what [`MetadataExt::blocks`] counts.
const BLOCK: u64 = 512;

impl Domain {
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

    pub(super) fn remove_shared_memory(&self) -> Result<(), Error> {
        for path in self.shared_memory()? {
            remove(&path)?;
        }
        Ok(())
    }

    /// Closes the object of the nodes' numbers to other users, under the start lock and before the first node's
    /// services are opened. A copy takes its place: who opened it in between holds a file that nobody uses.
    ///
    /// # Errors
    /// The copy could not be made.
    pub(crate) fn close_node_numbers(&self) -> Result<(), Error> {
        for path in self.shared_memory()? {
            let is_open = || path.metadata().is_ok_and(|found| found.mode() & OTHERS != 0);
            if path.to_string_lossy().ends_with(NODE_NUMBERS) && is_open() {
                replace_by_copy(&path).map_err(Error::io("close", &path))?;
            }
        }
        Ok(())
    }

    /// Takes the memory of every object now: the system gives pages when they are first written, and kills whoever
    /// writes to one when there is none left, in the midst of an episode.
    ///
    /// # Errors
    /// Shared memory is full.
    pub(crate) fn reserve_objects(&self) -> Result<(), Error> {
        for path in self.shared_memory()? {
            // Others come and go, and close what they are creating.
            let Ok(file) = OpenOptions::new().write(true).open(&path) else { continue };
            let Ok(found) = file.metadata() else { continue };
            if !found.is_file() || found.blocks() * BLOCK >= found.len() {
                continue;
            }
            // Systems that cannot do it give pages as before.
            if let Err(Errno::NOSPC) = fallocate(&file, FallocateFlags::KEEP_SIZE, 0, found.len()) {
                return Err(full(&path));
            }
        }
        Ok(())
    }

    /// Checks that every object is the user's, and closed to others.
    ///
    /// # Errors
    /// [`Error::Directory`] for the first that is not.
    pub(crate) fn check_objects(&self) -> Result<(), Error> {
        for path in self.shared_memory()? {
            // Others come and go while one looks.
            let Ok(found) = path.symlink_metadata() else { continue };
            let problem = if found.uid() != self.uid {
                format!("belongs to user {}: have it removed", found.uid())
            } else if found.mode() & OTHERS != 0 {
                format!("is open to other users: `chmod go= {}`", path.display())
            } else {
                continue;
            };
            return Err(Error::Directory { path, problem });
        }
        Ok(())
    }
}

fn full(path: &Path) -> Error {
    let no_room = || Error::io("reserve", path)(io::ErrorKind::StorageFull.into());
    check_not_full(Path::new(SHARED_MEMORY)).err().unwrap_or_else(no_room)
}

fn replace_by_copy(path: &Path) -> io::Result<()> {
    let mut copy = path.as_os_str().to_owned();
    copy.push(UNFINISHED);
    // Of a process that was killed here.
    ignore_missing(fs::remove_file(&copy))?;
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&copy)?;
    file.write_all(&fs::read(path)?)?;
    fs::rename(&copy, path)
}

/// Removes whatever carries the domain's name, a folder as well.
pub(super) fn remove(path: &Path) -> Result<(), Error> {
    let removed = match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::IsADirectory => fs::remove_dir_all(path),
        other => other,
    };
    ignore_missing(removed).map_err(Error::io("remove", path))
}

pub(super) fn ignore_missing(result: io::Result<()>) -> io::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn domain(name: &str) -> Domain {
        Domain::new(&format!("{name}-{}", std::process::id())).unwrap()
    }

    fn object(domain: &Domain, name: &str) -> PathBuf {
        let path = Path::new(SHARED_MEMORY).join(format!("{}{name}", domain.prefix));
        fs::write(&path, [1, 2, 3]).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o666)).unwrap();
        path
    }

    #[test]
    fn the_numbers_of_nodes_are_closed_and_whoever_opened_them_is_left_behind() {
        let domain = domain("numbers");
        let numbers = object(&domain, "0_10_0.global_mgmt");
        let mut early = OpenOptions::new().write(true).open(&numbers).unwrap();
        assert!(domain.check_objects().unwrap_err().to_string().contains("is open to other users"));
        domain.close_node_numbers().unwrap();
        domain.check_objects().unwrap();
        early.write_all(&[9, 9, 9]).unwrap();
        assert_eq!(fs::read(&numbers).unwrap(), [1, 2, 3]);
        assert_eq!(numbers.metadata().unwrap().mode() & 0o777, 0o600);
        let closed = numbers.metadata().unwrap().ino();
        domain.close_node_numbers().unwrap();
        assert_eq!(numbers.metadata().unwrap().ino(), closed, "what is closed stays");
        domain.remove_shared_memory().unwrap();
        assert!(!numbers.exists());
    }

    #[test]
    fn nobody_joins_a_domain_with_an_object_that_others_may_open() {
        let domain = domain("opened");
        let member = domain.enter().unwrap();
        let open = object(&domain, "bell");
        let refused = domain.enter().unwrap_err();
        assert!(refused.to_string().contains("bell: is open to other users: `chmod go= "));
        assert_eq!(refused.exit_code(), 74);
        fs::set_permissions(&open, Permissions::from_mode(0o600)).unwrap();
        drop(domain.enter().unwrap());
        drop(member);
        assert!(!open.exists());
    }
}
