//! What another run has learned, as far as a new one begins with it.

use std::path::Path;

use sortie_bundle::TRAINING;
use sortie_envs::Spec;
use sortie_learn::LearnError;
use sortie_learn::configuration::OptimiserConfig;
use sortie_learn::run::RunFolder;
use sortie_learn::run::checkpoint::{Checkpoint, OpenFor};
use sortie_nn::layers::gru::lengths;

use super::Config;
use super::agents::{UtilityNetwork, UtilityShape};

/// What another run has learned, by whichever preset.
#[derive(Clone, Debug)]
pub(crate) struct Learned {
    /// The agents' network; its averaged weights where the run averages.
    pub(crate) network: UtilityNetwork,
    /// The recurrent unit of the agents' memory; empty where they have none.
    pub(crate) memory_unit: Vec<f32>,
    /// What teams are worth at subtasks, if the run learned that.
    pub(crate) team_values: Option<UtilityNetwork>,
}

impl Learned {
    /// Reads the newest sound checkpoint of a run that learned in such an environment.
    ///
    /// # Errors
    /// There is none, or its networks are others than its configuration says.
    pub(crate) fn open(folder: &Path, spec: &Spec) -> Result<Self, LearnError> {
        let files = RunFolder::new(folder);
        let config = Config::of(&files.read_description()?.config)
            .map_err(|error| LearnError::format(folder.join(TRAINING), error))?;
        let checkpoint = &files.checkpoints().newest(OpenFor::Use)?.checkpoint;
        match config {
            Config::Records(config) => {
                let shape = config.learns_allocator().then(|| config.allocator.shape(spec));
                let name = |of, optimiser| format!("{of}/{}", measured(optimiser));
                let value = |shape| {
                    let name = name("allocator", &config.allocator.optimiser);
                    network(checkpoint, &name, shape)
                };
                let agents = name("agents", &config.optimiser);
                Ok(Self {
                    network: network(checkpoint, &agents, config.network.shape(spec))?,
                    memory_unit: Vec::new(),
                    team_values: shape.map(value).transpose()?,
                })
            }
            Config::Windows(config) => {
                let level = &config.low_level;
                let memory = if level.recurrent { lengths(level.base).iter().sum() } else { 0 };
                Ok(Self {
                    network: network(checkpoint, "agents/online", config.agents(spec))?,
                    memory_unit: match memory {
                        0 => Vec::new(),
                        count => checkpoint.whole_vector("memory/online", count)?,
                    },
                    team_values: None,
                })
            }
        }
    }
}

/// What checkpoints call the weights that are measured: those that are averaged, where any are.
pub(crate) fn measured(optimiser: &OptimiserConfig) -> &'static str {
    if optimiser.average_rate < 1.0 { "average" } else { "online" }
}

/// A network by its name in the checkpoint.
fn network(
    checkpoint: &Checkpoint,
    name: &str,
    shape: UtilityShape,
) -> Result<UtilityNetwork, LearnError> {
    Ok(UtilityNetwork { shape, parameters: checkpoint.vector(name, &shape.tensors())? })
}
