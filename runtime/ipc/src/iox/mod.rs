//! The links over iceoryx2: its only user. Rules for it that cost days to find:
//!
//! * one table of services for all processes, opened or created with the schema as attribute;
//! * nothing that a killed process could leave locked (no blackboard), nobody waits for a reader;
//! * bells by `try_wait`, `ppoll` and `try_wait` again: a wait set drained once loses wake-ups, and
//!   the library's timed wait is late by up to 12 ms;
//! * ports stay on the thread that made them; processes are spawned, never forked.

mod bell;
mod links;
mod message;
mod open;
mod services;

pub use links::{Housekeeping, IoxAgent, IoxAllocator, IoxWorld, LinkSetup};
pub(crate) use services::worst_case_bytes;
