//! What can go wrong outside the arithmetic.

use std::path::PathBuf;

use sortie_envs::StepError;
use sortie_envs::save_the_city::CityError;

/// Why a run cannot be set up, continued or measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnError {
    /// A configuration has an impossible value.
    #[error("configuration: {0}")]
    Config(String),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is there, but is not what it should be.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The environment could not be set up.
    #[error("environment: {0}")]
    Environment(#[from] CityError),
    /// The environment refused an action, which a sound policy never gives.
    #[error("environment: {0}")]
    Step(#[from] StepError),
    /// The team that is measured could not decide.
    #[error("the team could not decide: {0}")]
    Team(String),
}

impl LearnError {
    /// Names the file of an input or output error.
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        |source| Self::File { path, source }
    }

    /// Says what is wrong with a file.
    pub(crate) fn format(path: impl Into<PathBuf>, reason: impl ToString) -> Self {
        Self::Format { path: path.into(), reason: reason.to_string() }
    }
}
