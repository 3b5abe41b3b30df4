//! The bundle on disk: what the trainer writes and everything else reads.
//!
//! A folder with `bundle.toml` (contract, limits, network, and the SHA-256 of every other file), the networks as
//! ONNX and as plans (the agent's, and the allocator's where it was learned), golden observations with their expected
//! answers, a model card and a learning curve. The SHA-256 of `bundle.toml` is the bundle's id: one hash vouches for
//! everything, the policy that runs included.
#![forbid(unsafe_code)]

mod allocation;
mod bundle;
mod contract;
mod error;
pub mod files;
mod golden;
mod guards;
mod manifest;
mod policy_roles;
mod recording;
#[cfg(test)]
mod tests;

pub use allocation::{GoldenAllocation, GoldenValue, OwnedAllocationState};
pub use bundle::{
    ALLOCATOR, ALLOCATOR_PLAN, Bundle, CARD, CURVE, CURVE_DATA, Draft, GOLDEN, GUARDS, MANIFEST,
    POINTING_PARTS, POINTING_PLANS, POLICY_ROLES, PROPOSAL_PARTS, TRAINING,
};
pub use contract::{
    Affords, CONTRACT_ABI, ContractV1, FallbackAllocation, MilestoneSign, OptionsContract,
    PictureContract, SubtaskConditioning,
};
pub use error::BundleError;
pub use files::{hex, sha256};
pub use golden::{
    Golden, GoldenCase, GoldenEpisode, GoldenTick, MIN_ALLOCATIONS, MIN_CASES, OwnedObservation,
};
pub use guards::{guards_from_toml, guards_to_toml};
pub use manifest::{
    AGENT, AGENT_PLAN, AgentGraph, Contract, Environment, Limits, Manifest, Network, OPTION_GRAPHS,
    OPTIONS, POINTING, POLICY, PROPOSALS, PointingContract, TEAM_VALUE,
};
pub use policy_roles::PolicyRoles;
pub use recording::{RecordedAgent, RecordedFrame, Recording, RecordingError};
