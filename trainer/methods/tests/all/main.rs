//! Methods against recorded rounds of other code, and runs of them.

mod aiming;
mod allocator;
#[path = "../../src/golden_tests/files.rs"]
mod files;
mod hal;
mod ma_exp;
mod ma_exp_networks;
mod ma_exp_runs;
mod maac;
mod maac_runs;
mod mappo;
mod published;
mod reference;
mod sessions;
mod setups;
mod training;
mod value_factorisation;
mod value_factorisation_golden;
