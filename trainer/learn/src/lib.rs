//! Learns cooperative policies: layers with explicit gradients, algorithms, evaluation, ONNX export.
#![deny(unsafe_code)]

pub mod configuration;
pub mod error;
pub mod evaluate;
pub mod export;
pub mod layers;
pub mod methods;
pub mod optimise;
pub mod random;
pub mod report;
pub mod run;
pub mod schedule;
mod workers;

pub use error::LearnError;
