//! Plans of graphs agree with their graphs, and what is no graph is refused.

mod bundle;
mod compile;
mod entities;
mod judges;
mod laws;
mod pointing;
mod proposals;
mod recurrent;
mod shipped;
mod skip;
mod support;
mod team_value;
