//! Why a city cannot be set up.

use alloc::string::String;
use core::fmt;

/// A scenario set or a state that the rules do not allow.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CityError {
    /// There is no scenario set of that name.
    UnknownSet {
        /// The name.
        name: String,
        /// Those that there are.
        known: &'static [&'static str],
    },
    /// A scenario set breaks a limit; the text says which.
    Set(String),
    /// A state breaks a rule; the text says which.
    State(String),
}

impl fmt::Display for CityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownSet { name, known } => {
                write!(f, "no scenario set `{name}`; there are ")?;
                for (index, known) in known.iter().enumerate() {
                    write!(f, "{}`{known}`", if index == 0 { "" } else { ", " })?;
                }
                Ok(())
            }
            Self::Set(reason) => write!(f, "impossible scenario set: {reason}"),
            Self::State(reason) => write!(f, "impossible state: {reason}"),
        }
    }
}

impl core::error::Error for CityError {}
