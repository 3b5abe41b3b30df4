//! The methods by their names, for command lines and files.

use sortie_learn::session::MethodEntry;

use crate::{alma, dqn, hal, ma_exp, maac, value_factorisation};

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
