//! Why something is not signed, or not taken for signed.

use std::io;
use std::path::{Path, PathBuf};

use sortie_bundle::hex;
use sortie_core::signature::PublicKey;

/// What can be wrong with keys and signatures.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SignError {
    /// A file of keys is missing.
    #[error("{} is missing: `sortie sign --new KEY` makes a pair of keys", .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// A file could not be read or written.
    #[error("{}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A key of that name exists.
    #[error("{} is there already: a key is never replaced, choose another name", .path.display())]
    Exists {
        /// The file that is there.
        path: PathBuf,
    },
    /// The name of a key is none.
    #[error("`{name}` is no name of a key: up to 32 letters, digits, `.`, `_` and `-`")]
    Name {
        /// What was asked for.
        name: String,
    },
    /// A file is not as it was written.
    #[error("{}: {reason}; such files are written by sortie and never edited", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What shows it.
        reason: String,
    },
    /// A file was written by a newer program.
    #[error("{} has format {got}, this program reads {}: update sortie", .path.display(), crate::seal::FORMAT)]
    Version {
        /// The file.
        path: PathBuf,
        /// Its format.
        got: i64,
    },
    /// Others may read a secret key.
    #[error("{0} can be read by others (mode {mode:o}): it may be known to them; else `chmod 600 {0}`", .path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Nobody is trusted.
    #[error("{} holds no public key (`*.pub`): nobody is trusted", .path.display())]
    NoKeys {
        /// The folder or the file.
        path: PathBuf,
    },
    /// Nobody has signed.
    #[error("{0} is not signed: `sortie sign KEY {0}` does it", .what.display())]
    Unsigned {
        /// The bundle or the plan.
        what: PathBuf,
    },
    /// Somebody has signed, but nobody who is trusted.
    #[error("{} is signed, but with no key of {}", .what.display(), .trust.display())]
    Unknown {
        /// The bundle or the plan.
        what: PathBuf,
        /// The folder or the file of trusted keys.
        trust: PathBuf,
    },
    /// The key that signed is revoked.
    #[error("{} is signed with the key `{name}`, which is revoked: {reason}", .what.display())]
    Revoked {
        /// The bundle or the plan.
        what: PathBuf,
        /// The key's name.
        name: String,
        /// Why it is revoked.
        reason: String,
    },
    /// The signature is over another bundle, or over this one before it was changed.
    #[error("{}: the signature is over the bundle {signed}, this is {got}: it was changed since, or copied", .path.display())]
    OtherBundle {
        /// The file of the signature.
        path: PathBuf,
        /// The id that was signed.
        signed: String,
        /// The bundle's id.
        got: String,
    },
    /// The key did not make the signature.
    #[error("{}: not signed with the key {key}: forged, or changed since", .path.display())]
    Forged {
        /// The file of the signature.
        path: PathBuf,
        /// The key that is said to have signed.
        key: String,
    },
    /// The system gives no random numbers.
    #[error("the system gives no random numbers: {0}")]
    Random(getrandom::Error),
}

impl SignError {
    pub(crate) fn damaged(path: &Path, reason: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), reason: reason.into() }
    }

    pub(crate) fn forged(path: &Path, key: &PublicKey) -> Self {
        Self::Forged { path: path.to_owned(), key: hex(&key.0) }
    }

    /// Of a file of keys.
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Self::Missing { path },
            io::ErrorKind::AlreadyExists => Self::Exists { path },
            io::ErrorKind::InvalidData => Self::damaged(&path, source.to_string()),
            _ => Self::Io { path, source },
        }
    }
}
