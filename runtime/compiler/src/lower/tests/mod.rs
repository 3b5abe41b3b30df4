//! Plans of random networks against plain loops.

mod agent;
mod entities;
mod int8;
pub(in crate::lower) mod networks;
mod pointing;
mod proposals;
mod recurrent;
mod rounding;
