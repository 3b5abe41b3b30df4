//! Where a run learns.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::Constants;

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
