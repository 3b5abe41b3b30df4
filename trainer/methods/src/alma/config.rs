//! What a run of ALMA learns by, whichever of the two learners it has.

use sortie_learn::LearnError;
use sortie_learn::configuration::check_table;
use sortie_learn::session::Setup;
use toml::Table;

use super::configuration::{FAST, PAPER};
use super::{records, windows};
use crate::alma::agents::Conditioning;
use sortie_learn::configuration::Section;

/// What a run learns by.
#[derive(Clone, Debug, PartialEq)]
pub enum Config {
    /// Records of one step and one subtask: the preset `fast`.
    Records(Box<records::Config>),
    /// Windows of whole episodes: the preset `paper`.
    Windows(Box<windows::Config>),
}

impl Config {
    /// What a setup says.
    ///
    /// # Errors
    /// A key is unknown, or a value impossible.
    pub fn of(setup: &Setup) -> Result<Self, LearnError> {
        let mut own = setup.own.clone();
        settle_older(&mut own);
        check_table("", &own, keys(&own))?;
        let setup = Setup { own, ..setup.clone() };
        Ok(if is_windows(&setup.own) {
            Self::Windows(Box::new(windows::Config::of(&setup)?))
        } else {
            Self::Records(Box::new(records::Config::of(&setup)?))
        })
    }

    /// The method's name.
    pub(super) fn method(&self) -> &'static str {
        match (self.subtask(), self) {
            (_, Self::Windows(config)) if config.coach.enabled => "copa",
            (Conditioning::None, _) => "flat",
            (Conditioning::Mask | Conditioning::Input, _) => "alma",
        }
    }

    /// What the agents see of the subtasks.
    pub fn subtask(&self) -> Conditioning {
        match self {
            Self::Records(config) => config.network.subtask,
            Self::Windows(config) => config.low_level.conditioning,
        }
    }

    /// Steps between decisions, unless the open tasks change.
    pub fn interval(&self) -> u32 {
        match self {
            Self::Records(config) => config.allocation.interval,
            Self::Windows(config) => config.allocation.interval,
        }
    }
}

/// The keys of a setup's own table.
pub(super) fn keys(own: &Table) -> &'static [Section] {
    if is_windows(own) { PAPER } else { FAST }
}

/// Whether it learns from windows; tables about records do not say so.
fn is_windows(own: &Table) -> bool {
    own.get("learner").and_then(toml::Value::as_str) == Some("windows")
}

/// Runs that do not say whether embeddings skip the attention began when none did.
pub(super) fn settle_older(run: &mut Table) {
    if is_windows(run) {
        return;
    }
    for path in [&["network"][..], &["allocator", "network"]] {
        let section = path.iter().try_fold(&mut *run, |table, name| {
            table.entry(*name).or_insert_with(|| Table::new().into()).as_table_mut()
        });
        if let Some(section) = section {
            section.entry("skip").or_insert(false.into());
        }
    }
}
