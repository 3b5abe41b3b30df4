//! Checks before anything is created: what fails later has no readable cause.

use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use super::{Domain, SHARED_MEMORY};
use crate::error::Error;

/// Magic number of tmpfs, see statfs(2).
const TMPFS_MAGIC: u64 = 0x0102_1994;
/// Longest path of a Unix socket.
const SOCKET_PATH: usize = 107;
/// What iceoryx2 adds to root path and prefix in the name of a socket.
const SOCKET_NAME: usize = 46;
/// Shared memory that must be free, as a multiple of what the domain takes at most.
const HEADROOM: u64 = 4;

/// File descriptors that a process of a domain may need: 64 of its own, and 7 for each of 12 services.
const DESCRIPTORS: u64 = 64 + 12 * 7;

/// Checks that a process may open as many files as it needs.
pub(crate) fn check_descriptors() -> Result<(), Error> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    match limit {
        Some(limit) if limit < DESCRIPTORS => Err(directory(
            Path::new("/proc/self/fd"),
            format!("takes {limit} open files, a process needs {DESCRIPTORS}; raise `ulimit -n`"),
        )),
        _ => Ok(()),
    }
}

/// Checks that `path` exists, on tmpfs: setting up on a disk takes 25 times as long.
pub(crate) fn check_tmpfs(path: &Path) -> Result<(), Error> {
    let status = rustix::fs::statfs(path).map_err(|error| directory(path, error))?;
    if status.f_type as u64 == TMPFS_MAGIC {
        Ok(())
    } else {
        Err(directory(path, "is not on tmpfs; set `SORTIE_BASE` to a directory that is"))
    }
}

/// Checks that the socket paths of the domain fit the system's limit.
pub(crate) fn check_path_length(domain: &Domain) -> Result<(), Error> {
    let root = domain.iox_root();
    let length = root.as_os_str().as_bytes().len() + domain.prefix().len() + SOCKET_NAME;
    if length <= SOCKET_PATH {
        return Ok(());
    }
    Err(directory(
        &root,
        format!(
            "gives socket paths of {length} bytes, the system takes {SOCKET_PATH}; use a shorter domain id or base directory"
        ),
    ))
}

/// Creates the domain's directory, for its user only.
pub(super) fn create_directory(path: &Path) -> Result<(), Error> {
    use std::os::unix::fs::DirBuilderExt;
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
        .map_err(|error| directory(path, format!("cannot be created: {error}")))
}

/// Checks that shared memory has room for `bytes`, with headroom: writing to a full one kills the
/// process.
pub(crate) fn check_space(bytes: u64) -> Result<(), Error> {
    let path = Path::new(SHARED_MEMORY);
    let status = rustix::fs::statvfs(path).map_err(|error| directory(path, error))?;
    let free = status.f_bavail.saturating_mul(status.f_frsize);
    let needed = bytes.saturating_mul(HEADROOM);
    if free >= needed {
        return Ok(());
    }
    let kib = |bytes: u64| bytes.div_ceil(1 << 10);
    Err(directory(path, format!("has {} KiB free, the domain needs {}", kib(free), kib(needed))))
}

fn directory(path: &Path, problem: impl ToString) -> Error {
    Error::Directory { path: path.to_path_buf(), problem: problem.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_the_limit_of_socket_paths() {
        let parent = Path::new("/dev/shm").join("x".repeat(60));
        let domain = Domain::under(&parent, "team").unwrap();
        let error = check_path_length(&domain).unwrap_err();
        assert!(error.to_string().contains("the system takes 107"), "{error}");
        assert_eq!(error.exit_code(), 74);
    }

    #[test]
    fn refuses_what_is_not_tmpfs() {
        let error = check_tmpfs(Path::new("/proc")).unwrap_err();
        assert!(error.to_string().contains("not on tmpfs"), "{error}");
    }

    #[test]
    fn refuses_a_domain_that_does_not_fit() {
        let error = check_space(u64::MAX).unwrap_err();
        assert!(error.to_string().contains("KiB free"), "{error}");
        assert_eq!(error.exit_code(), 74);
    }
}
