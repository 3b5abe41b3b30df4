//! Patterns on the typed graph, recognised by structure and never by name.

mod agent;
mod linear;

pub(crate) use agent::{AgentLayers, match_agent};
pub(crate) use linear::{Layer, Matrix};
