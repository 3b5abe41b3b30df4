//! A domain: one deployment on one host, its paths and its names.

mod bundles;
mod facts;
mod membership;
mod objects;
pub(crate) mod preflight;

use std::env;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sortie_core::identity::fnv1a;

use crate::error::Error;

pub use bundles::{TeamBundle, TeamBundles, model_text};
pub use facts::{DomainContract, DomainFacts, Draws};
pub(crate) use facts::{nanoseconds, read_file, write_file};
pub use membership::{Lock, Membership, Starting};

/// Where POSIX shared memory lives, whatever the base directory.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// Directory in which domains live, instead of the default.
const BASE_VARIABLE: &str = "SORTIE_BASE";
/// Longest name of a domain.
const ID_LENGTH: usize = 24;

/// One deployment on one host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Domain {
    id: String,
    pub(crate) uid: u32,
    base: PathBuf,
    /// Of all its shared-memory objects.
    pub(crate) prefix: String,
}

impl Domain {
    /// The domain `id`, under `SORTIE_BASE`, else `/dev/shm`, else `XDG_RUNTIME_DIR`.
    ///
    /// # Errors
    /// The id has other characters than `a-z`, `0-9` and `-`, or no or more than 24 of them; or
    /// there is no tmpfs to live on, or `SORTIE_BASE` names no directory.
    pub fn new(id: &str) -> Result<Self, Error> {
        let uid = rustix::process::getuid().as_raw();
        let parent = match env::var_os(BASE_VARIABLE) {
            Some(directory) => existing(PathBuf::from(directory))?,
            None => default_parent(uid)?,
        };
        Self::under(&parent, id)
    }

    /// The domain `id` under a directory of the caller's choice, which must be on tmpfs.
    ///
    /// # Errors
    /// The id has other characters than `a-z`, `0-9` and `-`, or no or more than 24 of them.
    pub fn under(parent: &Path, id: &str) -> Result<Self, Error> {
        let is_allowed =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
        if id.is_empty() || id.len() > ID_LENGTH || !id.bytes().all(is_allowed) {
            return Err(Error::DomainId(id.to_string()));
        }
        let uid = rustix::process::getuid().as_raw();
        Ok(Self::of_user(uid, parent, id))
    }

    /// Paths and names have the id in them, or a number in its place where socket paths would be too long.
    fn of_user(uid: u32, parent: &Path, id: &str) -> Self {
        let named = |name: &str, prefix: String| {
            let base = parent.join(name);
            Self { id: id.to_string(), uid, base, prefix }
        };
        let plain = named(id, format!("sortie-{uid}-{id}-"));
        if preflight::check_path_length(&plain).is_ok() {
            return plain;
        }
        // No id has an underscore.
        let short = format!("_{:010x}", fnv1a(format!("{uid}/{id}").as_bytes()) >> 24);
        named(&short, format!("sortie-{short}-"))
    }

    /// The id.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The directory of all its files.
    pub fn base(&self) -> &Path {
        &self.base
    }

    pub(crate) fn iox_root(&self) -> PathBuf {
        self.base.join("iox")
    }

    /// Name of the doorbell's shared-memory object.
    pub(crate) fn bell_object(&self) -> String {
        format!("{}bell", self.prefix)
    }

    /// Whether a shared-memory object is this domain's: the prefix, and no further `-`, which
    /// would be part of a longer id.
    pub(crate) fn owns(&self, object: &str) -> bool {
        object.strip_prefix(&self.prefix).is_some_and(|rest| !rest.contains('-'))
    }

    /// The directory above, if it is the one that this crate creates for a user's domains.
    pub(crate) fn own_parent(&self) -> Option<&Path> {
        self.base.parent().filter(|parent| parent.ends_with(own_parent(self.uid)))
    }

    /// Why the library has failed, as far as that can be known: it does not tell a lack of room from others.
    pub(crate) fn explain(&self, what: &str, problem: String) -> Error {
        for directory in [Path::new(SHARED_MEMORY), self.base()] {
            if let Err(full) = preflight::check_not_full(directory) {
                return full;
            }
        }
        Error::SharedMemory { what: what.to_string(), problem }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.base.join(name)
    }
}

fn own_parent(uid: u32) -> String {
    format!("sortie-{uid}")
}

/// The directory that the user has chosen.
fn existing(directory: PathBuf) -> Result<PathBuf, Error> {
    if directory.is_dir() {
        return Ok(directory);
    }
    let problem = format!("is no directory, but `{BASE_VARIABLE}` names it: choose one on tmpfs");
    Err(Error::Directory { path: directory, problem })
}

fn default_parent(uid: u32) -> Result<PathBuf, Error> {
    let shared_memory = Path::new(SHARED_MEMORY);
    let problem = match preflight::check_tmpfs(shared_memory) {
        Ok(()) => return Ok(shared_memory.join(own_parent(uid))),
        Err(problem) => problem,
    };
    match env::var_os("XDG_RUNTIME_DIR") {
        Some(directory) => Ok(PathBuf::from(directory).join("sortie")),
        None => Err(problem),
    }
}

/// What a domain's bells are. All its processes use the same: who listens to the one is not woken by
/// the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BellKind {
    /// Counters in shared memory on which the kernel lets processes sleep. Linux only.
    Doorbell,
    /// Events of iceoryx2: a socket for each listener.
    Event,
}

impl Default for BellKind {
    /// The doorbell where the system has it.
    fn default() -> Self {
        if cfg!(target_os = "linux") { Self::Doorbell } else { Self::Event }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_ids_that_do_not_fit_paths() {
        for id in ["", "Team", "a/b", "a_b", "..", &"x".repeat(25)] {
            let refused = Domain::under(Path::new("/dev/shm"), id);
            assert!(matches!(refused, Err(Error::DomainId(_))), "{id}");
        }
        assert!(Domain::under(Path::new("/dev/shm"), "team-7").is_ok());
    }

    #[test]
    fn ids_of_every_length_fit_paths_of_every_user() {
        for uid in [0, 1000, u32::MAX] {
            let parent = Path::new(SHARED_MEMORY).join(own_parent(uid));
            let domains = (1..=ID_LENGTH).map(|length| {
                let domain = Domain::of_user(uid, &parent, &"x".repeat(length));
                preflight::check_path_length(&domain).unwrap();
                domain
            });
            let domains: Vec<Domain> = domains.collect();
            assert!(domains[0].base().ends_with("x"));
            let [.., one, other] = domains.as_slice() else { unreachable!() };
            assert_ne!(one.base(), other.base());
            assert!(one.owns(&one.bell_object()) && !one.owns(&other.bell_object()));
        }
    }

    #[test]
    fn never_owns_what_belongs_to_a_longer_id() {
        let domain = Domain::under(Path::new("/dev/shm"), "team").unwrap();
        let longer = Domain::under(Path::new("/dev/shm"), "team-2").unwrap();
        let object = format!("{}123_4.connection", longer.prefix);
        assert!(longer.owns(&object));
        assert!(!domain.owns(&object));
    }

    #[test]
    fn asking_whether_a_domain_is_alive_creates_nothing() {
        let domain = Domain::new(&format!("asked-{}", std::process::id())).unwrap();
        assert!(!domain.is_alive().unwrap() && !domain.base().exists());
        preflight::create_directory(&domain).unwrap();
        assert!(!domain.is_alive().unwrap());
        assert_eq!(std::fs::read_dir(domain.base()).unwrap().count(), 0);
        std::fs::remove_dir(domain.base()).unwrap();
        let member = domain.enter().unwrap();
        assert!(domain.is_alive().unwrap());
        drop(member);
    }
}
