//! The built-in environments: rules, laws, and episodes that were recorded elsewhere.

mod gridworld;
mod group_matching;
mod milestones;
mod particle;
mod save_the_city;
