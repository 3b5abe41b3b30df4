//! One policy over inputs of fixed sizes, served in shared memory: a server decides, a robot's program asks.

mod client;
mod decider;
mod engine;
mod fallback;
mod presence;
mod schema;
mod served;
mod server;

pub use client::{Action, ClientCounters, ClientSettings, PolicyClient};
pub use engine::Engine;
pub use fallback::Fallback;
pub(crate) use schema::ServedFacts;
pub use schema::{Expected, PolicySchema, Port};
pub use served::{ServeCounters, Served};
pub use server::{PolicyServer, ServeSettings};
