//! Matched layers become operators and weights, and both the bytes of a plan.

mod agent;
mod assemble;
mod entities;
mod int8;
mod int8_layout;
mod layout;
mod policy;
mod proposals;
mod rounding;
#[cfg(test)]
mod tests;

pub(crate) use agent::{AgentSizes, Choice, lower_agent};
pub(crate) use assemble::{Origin, assemble};
pub(crate) use entities::{EntitySizes, lower_entities};
pub(crate) use int8::lower_agent_int8;
pub(crate) use policy::{LoweredPolicy, lower_policy};
pub(crate) use proposals::lower_proposals;
