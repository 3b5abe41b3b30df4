//! Learns cooperative policies: layers with explicit gradients, algorithms, evaluation, ONNX export.
#![deny(unsafe_code)]

pub mod layers;
pub mod methods;
pub mod random;
