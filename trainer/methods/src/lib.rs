//! The methods.
//!
//! A method is a [`Method`](sortie_learn::Method); [`METHODS`] is what command lines and files find it by.
#![forbid(unsafe_code)]

mod actor_critic;
pub mod allocator;
pub mod alma;
pub mod dqn;
#[cfg(test)]
mod golden_tests;
pub mod hal;
pub mod ma_exp;
pub mod maac;
pub mod mappo;
pub mod multi_explore;
mod novelty;
mod options;
mod pictures;
pub mod value_factorisation;

use sortie_learn::session::MethodEntry;

/// The learners of both presets of ALMA, part by part, for what measures them.
pub mod learners {
    pub use crate::alma::{ALMA, agents, records, teams, windows};
}

/// Allocators that propose, as graphs.
pub mod proposals {
    pub use sortie_nn::tape::Parameters;

    pub use crate::alma::agents::transpose;
    pub use crate::alma::windows::allocation::{
        AllocationCritic, AllocationPolicy, AllocationShape,
    };
    pub use crate::alma::windows::{ProposalGraphs, export_proposals};
}

/// Every method of this crate.
pub const METHODS: &[MethodEntry] = &[
    alma::ALMA,
    alma::FLAT,
    alma::COPA,
    allocator::ALLOCATOR,
    value_factorisation::QMIX,
    value_factorisation::VDN,
    value_factorisation::REFIL,
    mappo::MAPPO,
    mappo::IPPO,
    maac::MAAC,
    maac::COMA,
    maac::COMA_SAC,
    maac::MADDPG,
    maac::MADDPG_SAC,
    maac::DDPG,
    ma_exp::MA_EXP,
    hal::HAL,
    hal::HAL_ORACLE,
    hal::H_DQN,
    dqn::DQN,
];

/// A method by its name.
pub fn find(name: &str) -> Option<&'static MethodEntry> {
    METHODS.iter().find(|entry| entry.name == name)
}
