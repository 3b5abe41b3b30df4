//! The methods.
//!
//! A method is a [`Method`](sortie_learn::Method); [`METHODS`] is what command lines and files find it by.
#![forbid(unsafe_code)]

mod actor_critic;
pub mod alma;
pub mod dqn;
pub mod hal;
pub mod ma_exp;
pub mod maac;
pub mod multi_explore;
mod novelty;
mod options;
mod pictures;
pub mod value_factorisation;

use serde::{Deserialize, Serialize};
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
    value_factorisation::QMIX,
    value_factorisation::VDN,
    value_factorisation::REFIL,
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

/// Any number of states; each has as many bytes as it needs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct SavedStates {
    bytes: Vec<u8>,
    /// Where each of them ends.
    ends: Vec<u32>,
}

impl SavedStates {
    pub(crate) fn push(&mut self, state: &[u8]) {
        self.bytes.extend_from_slice(state);
        self.ends.push(self.bytes.len() as u32);
    }

    pub(crate) fn at(&self, index: usize) -> &[u8] {
        let start = index.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.bytes[start as usize..self.ends[index] as usize]
    }

    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Gives back the memory that no state needs.
    pub(crate) fn shrink_to_fit(&mut self) {
        self.bytes.shrink_to_fit();
        self.ends.shrink_to_fit();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_of_any_length_come_back() {
        let mut states = SavedStates::default();
        let all = [&[1, 2, 3][..], &[], &[4], &[5, 6]];
        all.iter().for_each(|state| states.push(state));
        states.shrink_to_fit();
        assert_eq!(states.len(), 4);
        assert!((0..4).map(|index| states.at(index)).eq(all));
    }
}
