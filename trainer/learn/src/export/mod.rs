//! Writes networks as ONNX: opset 17, IR 8, plain operators, a symbolic entity count, no batch dimension.
//!
//! The files hold the plain form of a network; fast forms are the compiler's business. The graph itself defines
//! what a row that sees nothing gets, because engines differ there: masked logits become -1e30 before the
//! softmax and their weights 0 after it.

mod agent;
mod bundle;
mod onnx;
pub(crate) mod protobuf;

pub use agent::{AgentNetwork, ExportError, Layer, Layout, Matrix, agent_onnx};
pub use bundle::{Measured, check_deployable, draft_bundle};
