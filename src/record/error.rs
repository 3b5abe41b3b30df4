//! What is wrong with a record.

use std::io;

/// Why a record cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The file cannot be read or written.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The first bytes are not those of an MCAP file.
    #[error("no record: it does not begin as an MCAP file does")]
    NotARecord,
    /// The file ends in the midst of something, as it does where its writer was killed.
    #[error(
        "ends in the midst of what begins at byte {at}; `sortie record --finish FILE` keeps all before it"
    )]
    Torn {
        /// Where that begins.
        at: u64,
    },
    /// Something is not as the format has it.
    #[error("{what} at byte {at} is broken")]
    Broken {
        /// What is broken.
        what: &'static str,
        /// Where it begins.
        at: u64,
    },
    /// A chunk is compressed in a way that is not read here.
    #[error("the chunk at byte {at} is compressed by `{by}`, and only `lz4` is read here")]
    Compression {
        /// How it says it is compressed.
        by: String,
        /// Where it begins.
        at: u64,
    },
}
