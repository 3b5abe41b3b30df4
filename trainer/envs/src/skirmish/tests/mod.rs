//! Skirmishes against their rule book and recorded fights.

mod golden;
mod laws;
mod scripts;
