//! The source graph run by tract: the reference for plans, and a back-end for hosts.

mod entities;
mod policy;
mod proposals;
mod team_value;

pub(crate) use entities::TractEntities;
pub use policy::TractPolicy;
pub(crate) use proposals::TractProposals;
pub use team_value::TractTeamValue;
