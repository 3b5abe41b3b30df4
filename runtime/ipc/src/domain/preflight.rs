//! Checks before anything is created: what fails later has no readable cause.

use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::Path;
use std::{fs, io};

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

/// Fewer bytes are not enough for anything.
const FULL: u64 = 64 << 10;

const ROOT: u32 = 0;
/// Bits of a directory's mode.
pub(super) const OTHERS: u32 = 0o077;
const WRITE_FOR_OTHERS: u32 = 0o022;
const STICKY: u32 = 0o1000;

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
    let length = root.as_os_str().as_bytes().len() + domain.prefix.len() + SOCKET_NAME;
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
pub(super) fn create_directory(domain: &Domain) -> Result<(), Error> {
    let path = domain.base();
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
        .map_err(|error| directory(path, format!("cannot be created: {error}")))?;
    check_ownership(domain)
}

/// Checks that nobody else can put anything into the domain, or another one in its place.
pub(crate) fn check_ownership(domain: &Domain) -> Result<(), Error> {
    for own in [domain.own_parent(), Some(domain.base())].into_iter().flatten() {
        let Some(found) = metadata(own)? else { continue };
        if found.uid() != domain.uid {
            return Err(foreign(own, found.uid()));
        }
        if !found.is_dir() {
            return Err(directory(own, "is no directory: have it removed"));
        }
        if found.mode() & OTHERS != 0 {
            let problem = format!("is open to other users: `chmod 700 {}`", own.display());
            return Err(directory(own, problem));
        }
    }
    check_parent(domain)
}

/// Whoever owns the directory above, or may write in it, can rename what is in it; unless it is as `/tmp` is.
fn check_parent(domain: &Domain) -> Result<(), Error> {
    let Some(parent) = domain.base().parent() else { return Ok(()) };
    let Ok(found) = fs::metadata(parent) else { return Ok(()) };
    if ![domain.uid, ROOT].contains(&found.uid()) {
        return Err(foreign(parent, found.uid()));
    }
    if found.mode() & WRITE_FOR_OTHERS != 0 && found.mode() & STICKY == 0 {
        let problem = format!("may be written by other users: `chmod go-w {}`", parent.display());
        return Err(directory(parent, problem));
    }
    Ok(())
}

/// Of the path itself: a link is another's way to lead elsewhere.
fn metadata(path: &Path) -> Result<Option<fs::Metadata>, Error> {
    match path.symlink_metadata() {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(directory(path, error)),
    }
}

fn foreign(path: &Path, uid: u32) -> Error {
    let problem = format!(
        "belongs to user {uid}, and a domain is one user's alone: run as that user, or set `SORTIE_BASE` to a directory of your own on tmpfs"
    );
    directory(path, problem)
}

/// Checks that shared memory has room for `bytes`, with headroom: writing to a full one kills the
/// process.
pub(crate) fn check_space(bytes: u64) -> Result<(), Error> {
    let path = Path::new(SHARED_MEMORY);
    let free = free_bytes(path)?;
    let needed = bytes.saturating_mul(HEADROOM);
    if free >= needed {
        return Ok(());
    }
    let kib = |bytes: u64| bytes.div_ceil(1 << 10);
    Err(directory(path, format!("has {} KiB free, the domain needs {}", kib(free), kib(needed))))
}

/// Checks that `path` has room for anything at all.
pub(crate) fn check_not_full(path: &Path) -> Result<(), Error> {
    let free = free_bytes(path).unwrap_or(u64::MAX);
    if free >= FULL {
        return Ok(());
    }
    let problem = format!("is full, {} KiB are free: free some of it and try again", free >> 10);
    Err(directory(path, problem))
}

/// Bytes that may still be written; none where no file can be created any more.
fn free_bytes(path: &Path) -> Result<u64, Error> {
    let status = rustix::fs::statvfs(path).map_err(|error| directory(path, error))?;
    // Systems without such a limit count no files.
    let has_files = status.f_files == 0 || status.f_favail > 0;
    Ok(if has_files { status.f_bavail.saturating_mul(status.f_frsize) } else { 0 })
}

fn directory(path: &Path, problem: impl ToString) -> Error {
    Error::Directory { path: path.to_path_buf(), problem: problem.to_string() }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

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
    fn refuses_a_directory_that_others_may_open() {
        let parent = tempfile::tempdir_in(SHARED_MEMORY).unwrap();
        let set_mode = |path: &Path, mode| {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        };
        let domain = Domain::under(parent.path(), "team").unwrap();
        let refusal = || check_ownership(&domain).unwrap_err().to_string();
        create_directory(&domain).unwrap();
        set_mode(domain.base(), 0o770);
        assert!(refusal().contains("team: is open to other users: `chmod 700"), "{}", refusal());
        set_mode(domain.base(), 0o700);
        set_mode(parent.path(), 0o777);
        assert!(refusal().contains("may be written by other users"), "{}", refusal());
        set_mode(parent.path(), 0o1777);
        let other = Domain { uid: domain.uid + 1, ..domain.clone() };
        let refused = check_ownership(&other).unwrap_err().to_string();
        assert!(refused.contains("team: belongs to user"), "{refused}");
        check_ownership(&domain).unwrap();
    }

    #[test]
    fn refuses_a_folder_of_all_domains_that_others_prepared() {
        let place = tempfile::tempdir_in(SHARED_MEMORY).unwrap();
        let uid = rustix::process::getuid().as_raw();
        let parent = place.path().join(format!("sortie-{uid}"));
        let domain = Domain::under(&parent, "team").unwrap();
        create_directory(&domain).unwrap();
        assert_eq!(parent.metadata().unwrap().mode() & OTHERS, 0);
        fs::set_permissions(&parent, fs::Permissions::from_mode(0o1777)).unwrap();
        let refused = check_ownership(&domain).unwrap_err().to_string();
        let name = format!("sortie-{uid}: is open to other users");
        assert!(refused.contains(&name), "{refused}");
        fs::remove_dir_all(&parent).unwrap();
        let elsewhere = place.path().join("elsewhere");
        fs::create_dir(&elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &parent).unwrap();
        let refused = create_directory(&domain).unwrap_err().to_string();
        assert!(refused.contains("have it removed"), "{refused}");
    }

    #[test]
    fn names_what_is_full() {
        assert!(check_not_full(Path::new(SHARED_MEMORY)).is_ok());
        let error = check_not_full(Path::new("/proc")).unwrap_err();
        assert!(error.to_string().starts_with("/proc: is full, 0 KiB are free"), "{error}");
    }

    #[test]
    fn refuses_a_domain_that_does_not_fit() {
        let error = check_space(u64::MAX).unwrap_err();
        assert!(error.to_string().contains("KiB free"), "{error}");
        assert_eq!(error.exit_code(), 74);
    }
}
