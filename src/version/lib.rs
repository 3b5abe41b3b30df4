//! What the programs are: their version, the commit they were built from, and how.
//!
//! A package of its own, so that another commit compiles this file and two short `main` functions, and links.

/// `0.1.0 (077de5c 2026-11-22)`.
pub const SHORT: &str = env!("SORTIE_VERSION");

/// The same, and how it was built.
pub const LONG: &str = concat!(env!("SORTIE_VERSION"), "\nbuilt: ", env!("SORTIE_BUILD"));
