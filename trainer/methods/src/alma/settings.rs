//! The configuration of any run.

use toml::Table;

use crate::alma::records::Conditioning;
use crate::alma::records::config::EnvironmentConfig;
use crate::alma::{records, windows};
use sortie_learn::LearnError;
use sortie_learn::configuration;
use sortie_learn::run::{Configuration, RunConfig};

/// How a run is configured, by what it learns from.
#[derive(Clone, Debug, PartialEq)]
pub enum Settings {
    /// Records of one step and one subtask: the preset `fast`.
    Records(records::Config),
    /// Windows of whole episodes: the preset `paper`.
    Windows(windows::Config),
}

impl Settings {
    /// A preset by name: `fast` or `paper`.
    pub fn preset(name: &str) -> Result<Self, LearnError> {
        match name {
            "fast" => Ok(Self::Records(records::Config::default())),
            "paper" => Ok(Self::Windows(windows::Config::default())),
            _ => Err(LearnError::Config(format!("no preset `{name}`; there are `fast`, `paper`"))),
        }
    }

    /// Reads a configuration; what is missing keeps its default.
    ///
    /// A run's `train.toml` will do: its lines about the run itself are passed over.
    pub fn from_toml(text: &str) -> Result<Self, LearnError> {
        if is_windows(&configuration::parsed(text)?) {
            Ok(Self::Windows(windows::Config::from_toml(text)?))
        } else {
            Ok(Self::Records(records::Config::from_toml(text)?))
        }
    }

    /// Replaces one value, named as in `run.steps=100_000`.
    pub fn set(&mut self, assignment: &str) -> Result<(), LearnError> {
        match self {
            Self::Records(config) => config.set(assignment),
            Self::Windows(config) => config.set(assignment),
        }
    }

    /// Has a run of the preset `fast` that is shorter than the preset's explore and hand over to its
    /// allocator sooner, in proportion. What `is_given` says stays as it is.
    pub fn fit_to_length(&mut self, is_given: impl Fn(&str) -> bool) {
        if let Self::Records(config) = self {
            config.fit_to_length(is_given);
        }
    }

    /// The configuration as a file that explains every key.
    pub fn explained(&self) -> Result<String, LearnError> {
        match self {
            Self::Records(config) => config.explained(),
            Self::Windows(config) => config.explained(),
        }
    }

    /// The world that is learned in.
    pub fn environment(&self) -> &EnvironmentConfig {
        match self {
            Self::Records(config) => &config.environment,
            Self::Windows(config) => &config.environment,
        }
    }

    /// The same, to be changed.
    pub fn environment_mut(&mut self) -> &mut EnvironmentConfig {
        match self {
            Self::Records(config) => &mut config.environment,
            Self::Windows(config) => &mut config.environment,
        }
    }

    /// What the agents see of the subtasks.
    pub fn subtask(&self) -> Conditioning {
        match self {
            Self::Records(config) => config.network.subtask,
            Self::Windows(config) => config.low_level.conditioning,
        }
    }

    /// The same, to be changed.
    pub fn subtask_mut(&mut self) -> &mut Conditioning {
        match self {
            Self::Records(config) => &mut config.network.subtask,
            Self::Windows(config) => &mut config.low_level.conditioning,
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

impl Configuration for Settings {
    fn method(&self) -> &str {
        match self {
            Self::Records(config) => config.method(),
            Self::Windows(config) => config.method(),
        }
    }

    fn to_toml(&self) -> Result<String, LearnError> {
        match self {
            Self::Records(config) => config.to_toml(),
            Self::Windows(config) => config.to_toml(),
        }
    }

    fn environment(&self) -> String {
        Self::environment(self).full_name()
    }

    fn instances(&self) -> usize {
        Self::environment(self).instances
    }

    fn run(&self) -> &RunConfig {
        match self {
            Self::Records(config) => &config.run,
            Self::Windows(config) => &config.run,
        }
    }

    fn run_mut(&mut self) -> &mut RunConfig {
        match self {
            Self::Records(config) => &mut config.run,
            Self::Windows(config) => &mut config.run,
        }
    }

    fn check(&self) -> Result<(), LearnError> {
        match self {
            Self::Records(config) => config.check(),
            Self::Windows(config) => config.check(),
        }
    }

    fn from_table(method: &str, table: Table) -> Result<Self, LearnError> {
        if is_windows(&table) {
            Ok(Self::Windows(windows::Config::from_table(method, table)?))
        } else {
            Ok(Self::Records(records::Config::from_table(method, table)?))
        }
    }
}

/// Whether a file is about learning from windows; files about records do not say so.
fn is_windows(table: &Table) -> bool {
    table.get("learner").and_then(toml::Value::as_str) == Some("windows")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::{records, windows};
    use sortie_learn::run::RunDescription;
    use sortie_nn::layers::products::Products;

    #[test]
    fn the_written_file_reads_back() {
        let mut config = records::Config::default();
        config.set("optimiser.learning_rate=0.0007").unwrap();
        let description = RunDescription::new(config, 7, 2);
        let text = description.to_toml().unwrap();
        assert_eq!(RunDescription::from_toml(&text).unwrap(), description, "{text}");
        assert_eq!(records::Config::from_toml(&text).unwrap(), description.config);
    }

    #[test]
    fn a_file_without_its_seed_is_refused() {
        let error =
            RunDescription::<records::Config>::from_toml("method = \"alma\"\nversion = \"0\"")
                .unwrap_err();
        assert!(error.to_string().contains("`seed`"), "{error}");
    }

    #[test]
    fn a_run_of_before_computes_its_products_as_it_did() {
        let text = RunDescription::new(records::Config::default(), 1, 1).to_toml().unwrap();
        let older = text.replace("products = \"widest\"\n", "");
        assert_ne!(older, text);
        let read = RunDescription::<records::Config>::from_toml(&older).unwrap();
        assert_eq!(read.config.run.products, Products::usual().to_string());
    }

    #[test]
    fn a_run_of_before_has_no_skip_and_is_repeated_without() {
        let text = RunDescription::new(records::Config::default(), 1, 1).to_toml().unwrap();
        let older = text.replace("skip = true\n", "");
        let read = RunDescription::<Settings>::from_toml(&older).unwrap().config;
        for found in [read, Settings::from_toml(&older).unwrap()] {
            let Settings::Records(found) = found else { panic!("another learner") };
            assert!(!found.network.skip && !found.allocator.network.skip);
        }
        // A file that somebody wrote leaves out what it does not change.
        assert!(records::Config::from_toml("[network]\nwidth = 32\n").unwrap().network.skip);
    }

    #[test]
    fn a_file_says_what_its_run_learns_from() {
        let records = RunDescription::new(records::Config::default(), 1, 1).to_toml().unwrap();
        let windows = RunDescription::new(windows::Config::default(), 1, 1).to_toml().unwrap();
        let read = |text: &str| RunDescription::<Settings>::from_toml(text).unwrap();
        assert!(matches!(read(&records).config, Settings::Records(_)));
        assert!(matches!(read(&windows).config, Settings::Windows(_)), "{windows}");
        assert_eq!(read(&windows).to_toml().unwrap(), windows);
        assert!(RunDescription::<records::Config>::from_toml(&windows).is_err());
    }
}
