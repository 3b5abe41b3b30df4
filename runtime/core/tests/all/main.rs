//! What programs see of the crate: plans, allocators, messages and roles.

mod allocators;
mod commands;
mod elementary;
mod golden_plans;
mod plan_format;
mod pointing;
mod refused_plans;
mod rewritten_frames;
mod roles;
#[cfg(feature = "signatures")]
mod signatures;
mod worlds;
