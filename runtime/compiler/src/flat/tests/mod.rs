//! What is what in small files made for it.

mod entities;
mod files;
mod graphs;
mod outputs;
mod plans;
mod states;
mod units;
