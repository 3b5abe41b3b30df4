//! Learns cooperative policies: algorithms, evaluation, ONNX export.
#![forbid(unsafe_code)]

pub mod configuration;
pub mod error;
pub mod evaluate;
pub mod export;
pub mod methods;
pub mod random;
pub mod report;
pub mod run;

pub use error::LearnError;
