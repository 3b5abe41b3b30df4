//! The engine of learning: whatever the method and the environment, it plays, measures, writes down, resumes, reports
//! and exports.
//!
//! A [`Method`] in an [`Environment`](sortie_envs::Environment) becomes a run by a [`Session`].
#![forbid(unsafe_code)]

mod act;
pub mod configuration;
pub mod draft;
pub mod error;
pub mod evaluate;
pub mod export;
pub mod learner;
pub mod method;
pub mod networks;
pub mod play;
mod protobuf;
pub mod random;
pub mod report;
pub mod run;
pub mod session;
pub mod state;
pub mod subtasks;
pub mod trajectory;

pub use act::{Act, Ask, Head, Scene, Scenes, Thought};
pub use error::LearnError;
pub use learner::Learner;
pub use method::{Method, Transition};
pub use run::Now;
pub use session::Session;
pub use state::State;
pub use trajectory::Trajectories;
