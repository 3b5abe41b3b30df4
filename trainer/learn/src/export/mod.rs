//! Writes networks as ONNX: opset 17, IR 8, plain operators, a symbolic entity count, no batch dimension.
//!
//! The files hold the plain form of a network; fast forms are the compiler's business. The graph itself defines
//! what a row that sees nothing gets, because engines differ there: masked logits become -1e30 before the
//! softmax and their weights 0 after it.

mod agent;
pub mod attention;
pub mod onnx;
mod own_row;
#[cfg(test)]
mod pointing_tests;
#[cfg(test)]
mod skip_tests;

use sortie_bundle::OptionsContract;
use sortie_core::Policy;

pub use agent::{
    AgentNetwork, GruCell, RecurrentAgent, TeamValueExport, agent_onnx, recurrent_agent_onnx,
    team_value_onnx,
};
pub use attention::{AttentionNetwork, ExportError, Layer, Layout, Matrix, PairHead, PointingHead};
pub use own_row::{
    AGENT_NUMBER, DenseLayer, GOAL, LookupTables, OptionGraphs, OwnRowNetwork, OwnRowNetworks,
};

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

/// What a method says on the card of a bundle, beside what every card says. Empty words say nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Words {
    /// What its agents are; where it says nothing, what is known of networks of their kind.
    pub agents: String,
    /// What allocates them.
    pub allocator: String,
    /// What the figures mean.
    pub figures: String,
    /// How its training departs from the dissertation, as items of a list.
    pub departures: String,
    /// What the team is not made for.
    pub limits: String,
}
