//! What can be wrong with a bundle.

use std::io;
use std::path::PathBuf;

/// Why a bundle could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BundleError {
    /// The path holds no bundle.
    #[error("`{}` is not a bundle: it has no `bundle.toml`", .path.display())]
    NotABundle {
        /// The path that was opened.
        path: PathBuf,
    },
    /// A file that `bundle.toml` lists, or that every bundle has, is missing.
    #[error("`{}` is missing: copy or export the bundle again", .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// The target of a new bundle exists.
    #[error("`{}` exists already: choose another name or remove it first", .path.display())]
    Exists {
        /// The target.
        path: PathBuf,
    },
    /// A file could not be read or written.
    #[error("cannot access `{}`", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A folder, a pipe or a device stands where a file belongs.
    #[error("`{}` is not a regular file: copy or export the bundle again", .path.display())]
    NotAFile {
        /// What stands there.
        path: PathBuf,
    },
    /// A file is larger than any file of a bundle.
    #[error("`{}` has {bytes} bytes, no file of a bundle has more than {max}", .path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// The limit.
        max: u64,
    },
    /// `bundle.toml` cannot be understood.
    #[error("`{}` cannot be read", .path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: Box<toml::de::Error>,
    },
    /// The bundle was written by a newer program.
    #[error("`{}` has bundle format {got}, this program reads {max}: update sortie", .path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Its format.
        got: u32,
        /// The newest format that is understood.
        max: u32,
    },
    /// A file is not the one that `bundle.toml` vouches for.
    #[error(
        "`{}` was changed: its SHA-256 is {got}, `bundle.toml` says {want}; copy or export the bundle again",
        .path.display()
    )]
    Hash {
        /// The file.
        path: PathBuf,
        /// The hash in `bundle.toml`.
        want: String,
        /// The hash of the file.
        got: String,
    },
    /// The contract's fields do not have the hash that stands beside them.
    #[error(
        "`{}`: the contract's fields hash to {got}, `contract.hash` says {want}: a field was edited",
        .path.display()
    )]
    Contract {
        /// The file.
        path: PathBuf,
        /// The hash in the file.
        want: String,
        /// The hash of the fields.
        got: String,
    },
    /// The content of a file contradicts itself or the contract.
    #[error("`{}`: {reason}", .path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}
