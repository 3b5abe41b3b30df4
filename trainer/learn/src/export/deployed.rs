//! The agents of a method as they are deployed.

use sortie_core::Policy;

use super::attention::AttentionNetwork;

/// Agents that all run one attention network over the entities that they see.
pub struct DeployedAgents<'a> {
    /// The network.
    pub network: AttentionNetwork<'a>,
    /// What answers golden observations: the method's own pass.
    pub policy: Box<dyn Policy + 'a>,
}
