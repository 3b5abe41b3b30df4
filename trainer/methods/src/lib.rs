//! Methods that learn in any environment, by name.
//!
//! A method is a [`Method`](sortie_learn::Method); [`METHODS`] is what command lines and files find them by.
#![forbid(unsafe_code)]

pub mod alma;
pub mod registry;
pub mod value_factorisation;

pub use registry::{METHODS, find};
