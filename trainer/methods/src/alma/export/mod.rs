//! Runs of ALMA become bundles.

mod bundle;
mod card;
mod golden_allocations;
mod learned;
mod proposals;
#[cfg(test)]
mod tests;

pub use bundle::{check_exportable, draft_bundle};
pub use learned::LearnedAllocator;
pub use proposals::{ProposalGraphs, export_proposals};
