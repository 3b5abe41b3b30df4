//! The agents of a method as they are deployed.

use sortie_core::Policy;

use super::attention::AttentionNetwork;
use super::recurrent::GruCell;

/// Agents that all run one attention network over the entities that they see.
pub struct DeployedAgents<'a> {
    /// The network.
    pub network: AttentionNetwork<'a>,
    /// What they remember by, between the layer before the head and the head; no ReLU follows their attention then.
    pub memory: Option<GruCell<'a>>,
    /// What answers golden observations: the method's own pass.
    pub policy: Box<dyn Policy + 'a>,
}
