//! Where a run learns.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet};
use sortie_learn::LearnError;

/// The world to learn in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
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

    /// Environment and set by their names.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.name, self.set)
    }
}
