//! What a page brings along: a team and what it plays, as bytes.

use alloc::string::String;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use sortie_attention::AttentionLayers;

use crate::golden::GoldenObservation;
use crate::options::OptionSettings;

/// A team as it is deployed, and what it plays in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cast {
    /// The environment.
    pub environment: String,
    /// The set of starts.
    pub set: String,
    /// Hash of the contract.
    pub contract: u64,
    /// Ticks between two allocations.
    pub decision_interval: u32,
    /// What an agent does that has nothing better to do.
    pub safe_action: Option<u16>,
    /// The plans of the agents.
    pub plans: Vec<Vec<u8>>,
    /// The plan of each agent; empty where one is for all, or an agent runs options.
    pub plan_of: Vec<u16>,
    /// What an agent goes by that runs options; its plans are controller, meta-controller and affordances.
    pub options: Option<OptionSettings>,
    /// Who assigns agents to subtasks, where somebody does.
    pub allocator: Option<AllocatorCast>,
    /// What tells whom agents attend to, where they do.
    pub attention: Option<AttentionLayers>,
    /// The bundle's golden observations.
    pub golden: Vec<GoldenObservation>,
}

/// A learned allocator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AllocatorCast {
    /// The plan of the network that values teams.
    pub plan: Vec<u8>,
    /// Most entities N of the networks.
    pub entities: u16,
    /// Most subtasks T.
    pub tasks: u16,
    /// Largest team of one subtask.
    pub team_max: u16,
}

impl Cast {
    /// As a page holds it.
    ///
    /// # Errors
    /// There is no room for it.
    pub fn to_bytes(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_allocvec(self)
    }

    /// From what a page holds.
    ///
    /// # Errors
    /// The bytes are of another version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, postcard::Error> {
        postcard::from_bytes(bytes)
    }
}
