//! The source graph run by tract: the reference for plans, and a back-end for hosts.

mod entities;
mod flat;
mod policy;
mod proposals;
mod team_value;

pub(crate) use entities::TractEntities;
pub(crate) use flat::TractFlatPolicy;
pub use policy::TractPolicy;
pub(crate) use proposals::TractProposals;
pub use team_value::TractTeamValue;
