//! Cooperative environments, batch-first, with their scripted policies and allocation rules.
//!
//! One object holds many *instances* of an environment, each with its own generator. Nothing is
//! allocated after construction: observations are written into the caller's buffers.
//!
//! ```
//! use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet};
//! use sortie_envs::{Environment, ObservationBuffers};
//!
//! let set = ScenarioSet::named("2-5a_2-5b")?;
//! let mut city = SaveTheCity::new(set, Constants::default(), 8, 1)?;
//! let mut buffers = ObservationBuffers::new(&city.shape());
//! city.observe(0, &mut buffers.lend());
//! let outcome = city.step(0, &[0; 5])?;
//! assert!(!outcome.done());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(not(feature = "std"), no_std)]
#![forbid(unsafe_code)]

extern crate alloc;

pub mod environment;
#[cfg(feature = "std")]
pub mod golden;
pub mod group_matching;
pub mod random;
#[cfg(feature = "std")]
mod recorded;
pub mod save_the_city;

pub use environment::{
    Environment, ObservationBuffers, ObservationMut, Shape, StepError, StepOutcome, Subtasks,
};
