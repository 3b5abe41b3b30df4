//! The agents of a method as they are deployed.

use sortie_bundle::OptionsContract;
use sortie_core::Policy;

use super::attention::AttentionNetwork;
use super::lookup::LookupTables;
use super::options::OptionGraphs;
use super::own_row::OwnRowNetworks;
use super::recurrent::GruCell;

/// Agents, and what their answers are.
pub struct DeployedAgents<'a> {
    /// Their networks.
    pub networks: DeployedNetworks<'a>,
    /// What answers golden observations: the method's own pass.
    pub policy: Box<dyn Policy + 'a>,
}

/// What agents decide by.
pub enum DeployedNetworks<'a> {
    /// All run one attention network over the entities that they see.
    Attention {
        /// The network.
        network: AttentionNetwork<'a>,
        /// What they remember by, between the layer before the head and the head; no ReLU follows their attention then.
        memory: Option<GruCell<'a>>,
    },
    /// Each runs one of several networks over its own row.
    OwnRow(OwnRowNetworks),
    /// Each looks its answers up.
    Lookup(LookupTables),
    /// It goes from milestone to milestone.
    Options {
        /// By which rules.
        options: OptionsContract,
        /// The networks.
        graphs: OptionGraphs,
    },
}
