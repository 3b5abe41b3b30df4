//! What can go wrong outside the arithmetic.

use std::path::PathBuf;

use sortie_core::AllocateError;
use sortie_envs::{EnvironmentError, StepError};

/// Why a run cannot be set up, continued or measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnError {
    /// A configuration has an impossible value.
    #[error("configuration: {0}")]
    Config(String),
    /// A key of a configuration has an impossible value, or does not exist.
    #[error("{}`{key}` {reason}", at_line(*line))]
    Value {
        /// Its line in the file that was read, if one was.
        line: Option<usize>,
        /// The key, as in `replay.batch`.
        key: String,
        /// What is wrong, and what is possible.
        reason: String,
    },
    /// A file is no TOML.
    #[error("{}{reason}", at_line(Some(*line)))]
    Syntax {
        /// The line.
        line: usize,
        /// What stands there, and what is wrong with it.
        reason: String,
    },
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
    /// A folder holds something that would be overwritten.
    #[error("{}: {reason}", path.display())]
    Taken {
        /// The folder.
        path: PathBuf,
        /// What is in the way, and what to do.
        reason: String,
    },
    /// Another process learns in this folder.
    #[error("{}: process {process} is learning here", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
        /// Its number.
        process: String,
    },
    /// Learning has left the numbers: the loss of an update is not finite.
    #[error(
        "diverged at step {env_steps}: the loss of the {level} is {loss}; \
         begin anew with a lower learning rate or a lower bound for the gradient's norm"
    )]
    Diverged {
        /// Who learned: `agents` or `allocator`.
        level: &'static str,
        /// Environment steps taken.
        env_steps: u64,
        /// The first loss that is not finite.
        loss: f64,
    },
    /// A run computes its products with instructions that this processor does not have.
    #[error(
        "`run.products` is {asked}, which this processor does not have: a new run takes `--set run.products={widest}`, \
         one that goes on `--other-products`, with other bits from there on"
    )]
    Products {
        /// What the run needs.
        asked: String,
        /// The widest that there is.
        widest: String,
    },
    /// A method or a team does not fit an environment; the text says why.
    #[error("{0}")]
    Misfit(String),
    /// The environment could not be set up.
    #[error("environment: {0}")]
    Environment(Box<dyn std::error::Error + Send + Sync>),
    /// There is no such environment.
    #[error("{0}")]
    Choice(#[from] EnvironmentError),
    /// The environment refused an action, which a sound policy never gives.
    #[error("environment: {0}")]
    Step(#[from] StepError),
    /// The team that is measured could not decide.
    #[error("the team could not decide: {0}")]
    Team(String),
    /// What allocates the team that is measured refused.
    #[error("the team could not decide: {0}")]
    Allocate(#[from] AllocateError),
}

fn at_line(line: Option<usize>) -> String {
    line.map_or(String::new(), |line| format!("line {line}: "))
}

/// What may go wrong as [`LearnError`] says.
pub type Result<T, E = LearnError> = std::result::Result<T, E>;

impl LearnError {
    /// Passes on what an environment says.
    pub fn environment(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Environment(Box::new(error))
    }

    /// Names the file of an input or output error.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        |source| Self::File { path, source }
    }

    /// Says what is in the way in a folder.
    pub fn taken(path: impl Into<PathBuf>, reason: impl ToString) -> Self {
        Self::Taken { path: path.into(), reason: reason.to_string() }
    }

    /// Says what is wrong with a file.
    pub fn format(path: impl Into<PathBuf>, reason: impl ToString) -> Self {
        Self::Format { path: path.into(), reason: reason.to_string() }
    }
}
