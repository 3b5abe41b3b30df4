//! ALMA: agents act on the subtasks that an allocator gives them (dissertation chapter 7), with its variants, flat
//! agents and COPA.
//!
//! Two learners: one from [`records`], the preset `fast`, one from [`windows`], the preset `paper`.

pub mod agents;
pub mod coach;
mod config;
pub mod configuration;
pub mod evaluate;
pub mod export;
mod presets;
pub mod records;
pub mod run;
pub mod teams;
pub mod windows;

pub use config::Config;
pub use presets::{ALMA, COPA, FLAT, METHODS};
pub use run::{Run, RunAllocator};
