//! Patterns on the typed graph, recognised by structure and never by name.

mod agent;
mod linear;
mod team_value;

pub(crate) use agent::{AgentLayers, match_agent};
pub(crate) use linear::{Layer, Matrix};
pub(crate) use team_value::match_team_value;
