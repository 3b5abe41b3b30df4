//! One policy over inputs of fixed sizes, served in shared memory: a server decides, a robot's program asks.

mod asking;
mod client;
mod decider;
mod guarding;
mod schema;
mod server;

pub use asking::{Action, ClientCounters};
pub use client::{ClientSettings, PolicyClient};
pub use decider::Engine;
pub(crate) use schema::ServedFacts;
pub use schema::{Expected, Fallback, PolicySchema, Port};
pub use server::{PolicyServer, ServeCounters, ServeSettings, Served};
