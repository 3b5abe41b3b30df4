//! The runtime core: executes masked-attention policies, allocates agents to subtasks, speaks the wire format.
//!
//! No heap, no operating system, no panics: a plan is used in place, an arena is given by the caller,
//! every error is a small enum. One plan gives the same bits on every target.
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

pub mod allocate;
pub mod allocator;
pub mod checksum;
pub mod choose;
pub mod decide;
pub mod entities;
pub mod entity_mask;
pub mod identity;
pub mod kernels;
pub mod limits;
pub mod link;
pub mod math;
pub mod ops;
pub mod plan;
pub mod policy;
pub mod remember;
pub mod roles;
mod shape;
pub mod wire;
pub mod world;

pub use allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
pub use decide::PlanPolicy;
pub use entities::Entities;
pub use entity_mask::EntityMask;
pub use policy::{DecideError, Decision, NO_ACTION, Observation, Policy, visible};
pub use remember::Remembering;
pub use shape::Shape;
pub use world::{StepOutcome, UnavailableAction, World};
