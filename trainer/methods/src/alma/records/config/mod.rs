//! Everything that decides how a run learns, in one readable file.

mod agents;
mod allocation;
mod learning;

use serde::{Deserialize, Serialize};

pub use agents::{AgentNetworkConfig, MixerConfig, NetworkConfig, ReturnsConfig};
pub use allocation::{AllocationConfig, AllocatorConfig};
pub use learning::ReplayConfig;
pub use sortie_learn::configuration::{ExplorationConfig, OptimiserConfig};

use sortie_learn::LearnError;
use sortie_learn::configuration::require;
use sortie_learn::session::{EnvironmentChoice, Setup};

/// What a setup says. Its defaults are the preset `fast`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Where it learns.
    #[serde(skip)]
    pub environment: EnvironmentChoice,
    /// Who assigns agents to buildings while learning.
    pub allocation: AllocationConfig,
    /// The agents' network.
    pub network: AgentNetworkConfig,
    /// How the utilities of a team become its value.
    pub mixer: MixerConfig,
    /// How rewards become targets.
    pub returns: ReturnsConfig,
    /// What is kept and how much of it an update sees.
    pub replay: ReplayConfig,
    /// How much the agents try out.
    pub exploration: ExplorationConfig,
    /// How the weights follow the gradient.
    pub optimiser: OptimiserConfig,
    /// How the allocator learns.
    pub allocator: AllocatorConfig,
}

impl Config {
    /// What a setup says.
    ///
    /// # Errors
    /// A value is impossible, or does not go together with others.
    pub fn of(setup: &Setup) -> Result<Self, LearnError> {
        let config = Self { environment: setup.environment.clone(), ..setup.own()? };
        config.check()?;
        Ok(config)
    }

    /// Whether the run learns an allocator; without subtasks there is nothing to allocate.
    pub fn learns_allocator(&self) -> bool {
        self.allocation.is_learned() && self.network.subtask.has_subtasks()
    }

    /// Who allocates where the run is measured, by name.
    pub fn measured_allocation(&self) -> &'static str {
        if self.network.subtask.has_subtasks() { self.allocation.measured().name() } else { "none" }
    }

    /// Refuses values that do not go together.
    fn check(&self) -> Result<(), LearnError> {
        self.allocation.check()?;
        self.network.sizes().check("network")?;
        self.mixer.check()?;
        self.replay.check("replay")?;
        self.allocator.network.check("allocator.network")?;
        self.allocator.replay.check("allocator.replay")
    }
}
