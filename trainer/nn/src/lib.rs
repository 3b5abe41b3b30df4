//! Network layers with explicit gradients, what trains them, and threads that do so: no method, no environment.
#![deny(unsafe_code)]

pub mod gradient_check;
pub mod lanes;
pub mod layers;
pub mod optimise;
pub mod random;
pub mod schedule;
pub mod tape;
