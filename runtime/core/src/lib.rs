//! The runtime core: executes policies, allocates agents to subtasks, speaks the wire format.
//!
//! No heap, no operating system, no panics: a plan is used in place, an arena is given by the caller,
//! every error is a small enum. One plan gives the same bits on every target.
//!
//! A policy that `sortie compile policy.onnx -o policy.plan` made a plan of, in ten lines:
//!
//! ```
//! use sortie_core::include_plan;
//! use sortie_core::plan::{Aligned, Plan, arena_bytes};
//!
//! const PLAN: &[u8] = include_plan!("../../../examples/embed_c/cart.plan");
//!
//! let plan = Plan::load(PLAN)?;                      // checked once, used where it lies
//! let mut arena = Aligned([0; arena_bytes(PLAN)]);   // all memory that decisions need
//! let mut states = [0.0; 16];                        // what it remembers: plan.states()
//! for position in [0.5, 0.4, 0.2] {
//!     let mut force = [0.0];
//!     plan.respond(&mut arena.0, &[&[position]], &mut states, &mut [&mut force])?;
//!     assert!(force[0].abs() <= 1.0);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | for | see |
//! | --- | --- |
//! | policies over inputs of fixed sizes | [`Plan::respond`](plan::Plan::respond), [`Plan::choose`](plan::Plan::choose) |
//! | agents that see entities through masks | [`Policy`], [`PlanPolicy`], [`Observation`] |
//! | teams of several policies | [`PolicyByAgent`] |
//! | agents that act only on what lies within ranges | [`Guarded`] |
//! | agents that go from milestone to milestone | [`options`] |
//! | who works on which subtask | [`allocate`], [`Allocator`] |
//! | agents, allocator and world as processes or devices | [`wire`], [`roles`], [`link`] |
//! | images with only the operators that a plan needs | [`operators`] |
//!
//! | feature | adds |
//! | --- | --- |
//! | `alloc` | `plan::AlignedBytes`, for programs with a heap and without an operating system |
//! | `std` | `alloc`, and kernels chosen at run time by what the processor offers (the same bits, faster) |
//! | `serial` | links over serial lines: `link::Serial` and `link::Relay`, small packages without heap |
//! | `signatures` | `signature`: plans are taken only of somebody who is trusted |
//! | `defmt` | `defmt::Format` for errors, decisions and facts of a plan |
//! | `dsp` | int8 weights by the DSP extension of Cortex-M4, M7 and others (the same bits, faster), for plans laid out for it |
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

#[cfg(any(test, feature = "alloc"))]
extern crate alloc;
#[cfg(any(test, feature = "std"))]
extern crate std;

pub mod allocate;
pub mod allocator;
mod by_agent;
pub mod choose;
pub mod decide;
pub mod entities;
pub mod entity_mask;
mod guarded;
pub mod identity;
pub mod limits;
pub mod link;
pub mod options;
pub mod plan;
pub mod policy;
pub mod remember;
pub mod roles;
mod shape;
#[cfg(feature = "signatures")]
pub mod signature;
pub mod wire;
pub mod world;

/// The operators of a plan, for programs that link only what their plans need.
pub mod operators {
    pub use crate::ops::{
        AllOperators, FeedForward, Int8FeedForward, OpKind, OperatorSet, Policies,
    };
    pub use crate::plan::Needed;
}

/// What compilers of plans, trainers and tests of this repository take besides. It changes without notice.
#[doc(hidden)]
#[path = "."]
pub mod internal {
    pub mod checksum;
    pub mod kernels;
    pub mod math;
    pub mod ops;
}

use internal::{checksum, kernels, math, ops};

pub use allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
pub use by_agent::PolicyByAgent;
pub use decide::PlanPolicy;
pub use entities::Entities;
pub use entity_mask::EntityMask;
pub use guarded::Guarded;
pub use policy::{DecideError, Decision, NO_ACTION, Observation, Policy, visible};
pub use remember::Remembering;
pub use shape::Shape;
pub use world::{StepOutcome, UnavailableAction, World};
