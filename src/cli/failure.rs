//! How a verb fails: one line that says what to do, and an exit code that scripts may rely on.

use std::error::Error;
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::Path;

use sortie_bundle::BundleError;
use sortie_learn::LearnError;
use sortie_sign::SignError;

/// The exit codes that scripts may rely on; 0 is success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// A check found a difference.
    Difference = 1,
    /// The command line itself is wrong.
    Usage = 2,
    /// Training has left the numbers: a loss is not finite.
    Diverged = 3,
    /// A file's content is broken.
    BadData = 65,
    /// A file is missing.
    Missing = 66,
    /// Something that is needed is not running, or stopped answering.
    NotRunning = 69,
    /// A fault of this program.
    Bug = 70,
    /// Reading or writing failed.
    InputOutput = 74,
    /// Another instance holds what is needed.
    Busy = 75,
    /// The user may not.
    NotPermitted = 77,
    /// Contract or version do not fit.
    Mismatch = 78,
    /// Ended by Ctrl-C.
    Interrupted = 130,
    /// The reader of standard output has gone: what a shell reports of a program that SIGPIPE ended.
    NobodyReads = 141,
}

/// Why a verb ended without success.
#[derive(Debug)]
pub struct Failure {
    pub exit: Exit,
    /// One line: what failed, where, and what to do. Empty where another process says it.
    pub message: String,
}

pub type Outcome = Result<(), Failure>;

impl Exit {
    /// The exit code of another crate's error, which uses the same numbers.
    pub fn from_code(code: u8) -> Self {
        let known = [
            Self::Difference,
            Self::Usage,
            Self::Diverged,
            Self::BadData,
            Self::Missing,
            Self::NotRunning,
            Self::InputOutput,
            Self::Busy,
            Self::NotPermitted,
            Self::Mismatch,
            Self::Interrupted,
            Self::NobodyReads,
        ];
        known.into_iter().find(|exit| *exit as u8 == code).unwrap_or(Self::Bug)
    }
}

impl Exit {
    /// Of a file that could not be read or written.
    fn of_file(error: &std::io::Error) -> Self {
        match error.kind() {
            ErrorKind::NotFound => Self::Missing,
            ErrorKind::Interrupted => Self::Interrupted,
            // What the system did not say, this program found in the file.
            ErrorKind::InvalidData
            | ErrorKind::InvalidInput
            | ErrorKind::IsADirectory
            | ErrorKind::FileTooLarge
                if error.raw_os_error().is_none() =>
            {
                Self::BadData
            }
            _ => Self::InputOutput,
        }
    }
}

impl Failure {
    pub fn new(exit: Exit, message: impl Into<String>) -> Self {
        Self { exit, message: message.into() }
    }

    /// Reading or writing `path` failed.
    pub fn file(path: &Path, error: &std::io::Error) -> Self {
        if error.kind() == ErrorKind::Interrupted {
            return Self::new(Exit::Interrupted, "interrupted");
        }
        Self::new(Exit::of_file(error), format!("{}: {error}", path.display()))
    }

    /// Something that this program got wrong by itself.
    pub fn bug(error: impl Error) -> Self {
        Self::new(Exit::Bug, format!("{}; please report this", with_sources(&error)))
    }

    /// A check of recorded or computed figures found a difference.
    pub fn difference(message: impl Into<String>) -> Self {
        Self::new(Exit::Difference, message)
    }

    /// Puts what was being worked on before the message.
    pub fn within(self, what: impl Display) -> Self {
        Self { message: format!("{what}: {}", self.message), ..self }
    }
}

impl From<BundleError> for Failure {
    fn from(error: BundleError) -> Self {
        let exit = match &error {
            BundleError::NotABundle { .. } | BundleError::Missing { .. } => Exit::Missing,
            BundleError::Exists { .. } => Exit::Usage,
            BundleError::Io { .. } => Exit::InputOutput,
            BundleError::Version { .. } => Exit::Mismatch,
            _ => Exit::BadData,
        };
        Self::new(exit, with_sources(&error))
    }
}

impl From<SignError> for Failure {
    fn from(error: SignError) -> Self {
        let exit = match &error {
            SignError::Missing { .. } | SignError::NoKeys { .. } => Exit::Missing,
            SignError::Exists { .. } | SignError::Name { .. } => Exit::Usage,
            SignError::Io { source, .. } => Exit::of_file(source),
            SignError::Damaged { .. } => Exit::BadData,
            SignError::Version { .. } => Exit::Mismatch,
            SignError::Random(_) => Exit::InputOutput,
            // Whoever asks for signatures does not permit what has none that counts.
            _ => Exit::NotPermitted,
        };
        Self::new(exit, with_sources(&error))
    }
}

impl From<LearnError> for Failure {
    fn from(error: LearnError) -> Self {
        let exit = match &error {
            LearnError::Config(_) | LearnError::Value { .. } | LearnError::Taken { .. } => {
                Exit::Usage
            }
            LearnError::Busy { .. } => Exit::Busy,
            LearnError::Products { .. } => Exit::NotRunning,
            LearnError::Diverged { .. } => Exit::Diverged,
            LearnError::File { source, .. } => Exit::of_file(source),
            LearnError::Format { .. } | LearnError::Syntax { .. } => Exit::BadData,
            LearnError::Misfit(_) | LearnError::Environment(_) | LearnError::Choice(_) => {
                Exit::Usage
            }
            _ => Exit::Bug,
        };
        Self::new(exit, error.to_string())
    }
}

impl From<sortie_ipc::Error> for Failure {
    fn from(error: sortie_ipc::Error) -> Self {
        use sortie_ipc::Error;
        let advice = match &error {
            Error::Busy { what, .. } if ["the world", "the policy"].contains(&what.as_str()) => {
                "; choose another domain with `--domain NAME`"
            }
            Error::OtherTeam { .. } => {
                "; choose another domain with `--domain NAME`, or join its team with `--mix-teams`"
            }
            Error::OtherRate { .. } => {
                "; choose another domain with `--domain NAME`, or end that team with `sortie control shut-down`"
            }
            _ => "",
        };
        let message = with_sources(&error) + advice;
        Self { exit: Exit::from_code(error.exit_code()), message }
    }
}

/// Of links in memory, which do not fail.
impl From<sortie_core::link::LinkError> for Failure {
    fn from(error: sortie_core::link::LinkError) -> Self {
        Self::bug(error)
    }
}

/// An error and what caused it, on one line.
pub fn with_sources(error: &dyn Error) -> String {
    let mut message = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let cause_text = cause.to_string();
        // Transparent errors repeat their source.
        if !message.ends_with(&cause_text) {
            message = format!("{message}: {cause_text}");
        }
        source = cause.source();
    }
    message.replace('\n', " ").trim_end().to_string()
}
