//! What is what in small files made for it.

mod entities;
mod faults;
mod files;
mod finite;
mod graphs;
mod loops;
mod masks;
mod narrow;
mod operators;
mod outputs;
mod plans;
mod seldom;
mod states;
mod units;
