//! Writes networks as ONNX: opset 17, IR 8, plain operators, a symbolic entity count, no batch dimension.
//!
//! The files hold the plain form of a network; fast forms are the compiler's business. The graph itself defines
//! what a row that sees nothing gets, because engines differ there: masked logits become -1e30 before the
//! softmax and their weights 0 after it.

mod agent;
pub mod attention;
mod deployed;
mod entities;
mod lookup;
pub mod onnx;
mod options;
mod own_row;
mod recurrent;
#[cfg(test)]
mod skip_tests;
mod team_value;

pub use agent::{AgentNetwork, agent_onnx};
pub use attention::{AttentionNetwork, ExportError, Layer, Layout, Matrix};
pub use deployed::{DeployedAgents, DeployedNetworks};
pub use entities::{EntityNetwork, Members, entity_network_onnx};
pub use lookup::LookupTables;
pub use options::{GOAL, OptionGraphs};
pub use own_row::{AGENT_NUMBER, DenseLayer, OwnRowNetwork, OwnRowNetworks};
pub use recurrent::{GruCell, RecurrentAgent, recurrent_agent_onnx};
pub use team_value::{TeamValueExport, team_value_onnx};
