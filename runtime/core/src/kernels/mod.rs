//! Arithmetic on plain slices in a fixed order, so that every target computes the same bits.
//!
//! The contract ("exact" profile): no fused multiply-add; products of a matrix and a vector add one input
//! after the other to all outputs; dot products run in 16 lanes that a fixed tree joins. Inputs that are
//! exactly zero may be left out: they add ±0 to sums that are never -0.
//!
//! All is safe Rust over chunks of fixed size, which the compiler turns into vector instructions. Every
//! function is inlined into its caller, so that [`wide`] can build the whole executor a second time for AVX2.

pub mod dot;
pub mod nonzero;
pub mod product;
pub mod softmax;
pub mod wide;
