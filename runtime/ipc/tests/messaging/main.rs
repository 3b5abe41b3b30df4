//! The messaging of a team, over each of its links and as real processes.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "helpers of tests print as well")]

mod conformance;
mod control;
mod fill;
mod own_world;
mod policy;
mod private;
mod processes;
mod recorder;
mod signals;
mod starts;
mod stress;
mod supervisor;
mod swap;
mod threads;
mod toy;
mod unallocated;
