//! The messaging of a team, over each of its links and as real processes.

mod conformance;
mod control;
mod fill;
mod own_world;
mod private;
mod processes;
mod reload;
mod starts;
mod storm;
mod stress;
mod supervisor;
mod threads;
mod toy;
mod unallocated;
