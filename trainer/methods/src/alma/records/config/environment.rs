//! Where a run learns.

use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet};
use sortie_envs::{Choice, Split};
use sortie_learn::LearnError;
use sortie_learn::session::EnvironmentChoice;

/// The world to learn in.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentConfig {
    /// Name of the environment: `save-the-city`.
    pub name: String,
    /// Scenario set.
    pub set: String,
    /// Episodes that run at the same time; one that ends restarts at once.
    pub instances: usize,
    /// Numbers of the rules.
    pub constants: Constants,
}

impl Default for EnvironmentConfig {
    fn default() -> Self {
        Self {
            name: "save-the-city".to_owned(),
            set: "2-5a_2-5b".to_owned(),
            instances: 16,
            constants: Constants::default(),
        }
    }
}

impl EnvironmentConfig {
    /// The world that a setup names.
    ///
    /// # Errors
    /// There is no such setting.
    pub fn of(choice: &EnvironmentChoice) -> Result<Self, LearnError> {
        let EnvironmentChoice { name, set, instances, settings } = choice.clone();
        let asked = Choice { set: None, split: Split::Train, instances, settings: &settings };
        let constants = asked.settings()?;
        let set = if set.is_empty() { Self::default().set } else { set };
        Ok(Self { name, set, instances, constants })
    }

    /// The scenario set by its name.
    ///
    /// # Errors
    /// There is none of that name.
    pub fn scenario_set(&self) -> Result<ScenarioSet, LearnError> {
        ScenarioSet::named(&self.set).map_err(LearnError::environment)
    }

    /// The world, to open instances of it.
    ///
    /// # Errors
    /// There is no such scenario set.
    pub fn open(&self) -> Result<SaveTheCity, LearnError> {
        SaveTheCity::new(self.scenario_set()?, self.constants, 1, 0)
            .map_err(LearnError::environment)
    }
}
