//! Records of teams at work, as MCAP files (<https://mcap.dev/spec>), which others open as well.
//!
//! A [`Writer`] keeps nothing back: what was flushed is there whatever happens to the process. Such a file has neither chunks
//! nor an index. [`finish`] gives it both, also where its last bytes are missing; a [`Reader`] takes either kind.
//!
//! Written here rather than by the crate `mcap`, which takes a fifth of what all else takes to build, and whose files, cut off
//! in the midst of a chunk, its readers do not open.

#![forbid(unsafe_code)]

mod encode;
mod error;
mod finish;
mod read;
mod recent;
#[cfg(test)]
mod tests;
mod write;

pub use error::RecordError;
pub use finish::{Finished, finish};
pub use read::{Reader, Record};
pub use recent::Recent;
pub use write::{Message, Writer};
