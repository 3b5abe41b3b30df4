//! Skirmishes against their rule book and recorded fights.

mod laws;
