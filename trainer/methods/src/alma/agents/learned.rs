//! What a run that begins takes over from another.

use std::path::Path;

use sortie_envs::Spec;

use super::utility::UtilityNetwork;
use sortie_learn::LearnError;

/// What another run has learned, whichever learner it had.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The agents' network; its averaged weights where the run averages.
    pub network: UtilityNetwork,
    /// The recurrent unit of the agents' memory; empty where they have none.
    pub memory_unit: Vec<f32>,
    /// What teams are worth at subtasks, if the run learned that.
    pub team_values: Option<UtilityNetwork>,
}

/// Opens what the run in a folder has learned, in an environment like this one.
pub type OpenLearned = fn(&Path, &Spec) -> Result<Learned, LearnError>;

/// For methods that are not told how.
pub(crate) fn open_nothing(folder: &Path, _: &Spec) -> Result<Learned, LearnError> {
    Err(LearnError::Config(format!("nothing opens the run in {}", folder.display())))
}
