//! ALMA: agents act on the subtasks that an allocator gives them (dissertation chapter 7), with its variants, flat
//! agents and COPA.
//!
//! Two learners: one from [`records`], the preset `fast`, one from [`windows`], the preset `paper`.

pub mod configuration;
pub mod evaluate;
pub mod export;
pub mod records;
mod reference;
pub mod run;
mod session;
pub mod settings;
pub mod windows;

pub use reference::reference;
pub use run::{Run, RunAllocator};
pub use session::{begin, resume};
pub use settings::Settings;
