//! The C interface: plans in programs that are not written in Rust. `include/sortie.h` is its header.
//!
//! Every function is total: what a caller can get wrong is answered with a [`SortieError`], as far as C lets anyone see
//! it. Nothing is allocated: a policy lives in memory that the caller gives, its plan is used where it lies.
//!
//! | feature | adds |
//! | --- | --- |
//! | `agents` (default) | agents of teams, which see entities; without it only policies over inputs of fixed sizes, in half the flash |
//! | `std` (default) | kernels chosen at run time by what the processor offers; without it no operating system is needed |
#![no_std]
#![deny(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable
    )
)]

#[cfg(any(test, feature = "std"))]
extern crate std;

#[allow(unsafe_code, reason = "reads and writes what pointers of C point to")]
mod border;
mod errors;
#[allow(unsafe_code, reason = "functions that C calls")]
#[allow(clippy::missing_safety_doc, reason = "the header says it once, for all")]
mod exports;
#[allow(unsafe_code, reason = "lays guards into the caller's memory")]
mod guards;
#[cfg(test)]
mod header;
mod operators;
#[cfg(not(any(test, feature = "std")))]
#[allow(unsafe_code, reason = "calls a function that exists nowhere")]
mod panicked;
#[allow(unsafe_code, reason = "tells what lies in the caller's memory")]
mod placed;
#[allow(unsafe_code, reason = "cuts the caller's memory into parts")]
mod policy;

pub use errors::SortieError;
pub use exports::decide::*;
pub use exports::guard::*;
pub use exports::load::*;
pub use exports::robot::*;
pub use exports::sizes::*;
pub use exports::version::*;
pub use guards::SortieGuards;
pub use policy::SortiePolicy;
