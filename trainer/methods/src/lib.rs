//! The methods.
//!
//! A method is a [`Method`](sortie_learn::Method); [`METHODS`] is what command lines and files find it by.
#![forbid(unsafe_code)]

mod actor_critic;
pub mod alma;
pub mod dqn;
pub mod hal;
pub mod ma_exp;
pub mod maac;
pub mod multi_explore;
mod novelty;
mod options;
mod pictures;
pub mod registry;
mod saved_states;
pub mod value_factorisation;

pub use registry::{METHODS, find};
