//! What this program is: its version, the commit it was built from, and how.

/// `0.1.0 (077de5c 2026-11-22)`.
pub(crate) const SHORT: &str = env!("SORTIE_VERSION");

/// The same, and how it was built.
pub(crate) const LONG: &str = concat!(
    env!("SORTIE_VERSION"),
    "\nbuilt: ",
    env!("SORTIE_BUILD"),
    "\nfeatures: ",
    env!("SORTIE_FEATURES"),
);
