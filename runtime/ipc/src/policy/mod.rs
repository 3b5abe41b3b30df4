//! One policy over inputs of fixed sizes, served in shared memory: a server decides, a robot's program asks.

mod client;
mod decider;
mod fallback;
mod schema;
mod server;

pub use client::{Action, ClientCounters, ClientSettings, PolicyClient};
pub use fallback::Fallback;
pub use schema::{Expected, PolicySchema, Port};
pub use server::{PolicyServer, ServeCounters, ServeSettings, Served};
