//! Runs of ALMA become bundles.

mod bundle;
mod card;
mod golden_allocations;
mod proposals;
#[cfg(test)]
mod tests;

pub use bundle::{LearnedAllocator, check_exportable, draft_bundle};
pub use proposals::{ProposalGraphs, export_proposals};
