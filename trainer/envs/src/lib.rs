//! Cooperative environments, batch-first, with their scripted policies and allocation rules.
//!
//! One object holds many *instances* of an environment. Every random choice comes from a generator that is passed
//! in, and what is seen is rebuilt from states, see [`Environment`].
//!
//! ```
//! use sortie_envs::{EntitySet, Observation, Split, open, random::generator};
//!
//! let mut random = generator(1);
//! let mut city = open("save-the-city/2-5a_2-5b", Split::Train, 8, &Default::default())?;
//! city.reset(0, &mut random);
//! let mut state = Vec::new();
//! city.save(0, &mut state);
//! let mut seen = Observation::new(&city.spec().shape);
//! city.observe(&state, 0, EntitySet::MAX, &mut seen);
//! let step = city.step(0, &[0; 5], &mut random)?;
//! assert!(seen.agents() >= 2 && !step.done());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | feature | adds |
//! | --- | --- |
//! | `std` (default) | readers of recorded episodes, which need files and JSON |
#![cfg_attr(not(feature = "std"), no_std)]
#![forbid(unsafe_code)]

extern crate alloc;

mod battles;
mod bytes;
pub mod conformance;
pub mod crafting;
mod decisions;
mod entry;
pub mod environment;
mod failures;
pub mod frame;
#[cfg(feature = "std")]
pub mod golden;
pub mod gridworld;
pub mod group_matching;
pub mod milestones;
pub mod observation;
pub mod particle;
pub mod picture;
pub mod random;
#[cfg(feature = "std")]
mod recorded;
pub mod registry;
pub mod routing;
pub mod rows;
pub mod save_the_city;
pub mod skirmish;
pub mod smax;
pub mod spec;
mod throughput;
pub mod treasure_rooms;

pub use decisions::{DecisionPoints, UNASSIGNED};
pub use environment::{Environment, Episode, Split, StateError, Step, StepError};
pub use failures::Failing;
pub use frame::{Frame, FrameError, FrameReader};
pub use observation::{
    ActionSet, AgentSet, EntitySet, Observation, TaskSet, deployed_tasks, members,
};
pub use picture::Picture;
pub use random::Random;
pub use registry::{Choice, ENVIRONMENTS, Entry, EnvironmentError, open};
pub use rows::SparseRows;
pub use spec::{Metric, Name, Rewards, Role, Rule, Shape, Sign, Spec, SpecError, View};
pub use throughput::{observe_and_step, step_alone};
