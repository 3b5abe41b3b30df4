//! Why a ring cannot be set up.

use alloc::string::String;
use core::fmt;

/// Parameters that the rules do not allow.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ParametersError {
    /// A name that says no sizes.
    UnknownSet(String),
    /// A size outside its range.
    Size {
        /// What there would be so many of.
        what: &'static str,
        /// How many.
        count: usize,
        /// The most that there may be.
        most: usize,
    },
    /// The noise is no probability.
    Noise,
    /// Episodes without a step.
    NoSteps,
    /// Held-out starts where none or all are.
    HeldOut,
}

impl fmt::Display for ParametersError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownSet(name) => write!(
                f,
                "no set `{name}`; a set is named AGENTSxCELLSxGROUPS, such as `8x6x2`, and may end \
                 in `-fixed`"
            ),
            Self::Size { what, count, most } => {
                write!(f, "{count} {what} are not possible: from 1 to {most} are")
            }
            Self::Noise => f.write_str("the noise is not a probability from 0 to 1"),
            Self::HeldOut => f.write_str(
                "what is held out leaves no starts to learn from, or none to measure on",
            ),
            Self::NoSteps => f.write_str("an episode limit of 0 steps leaves no episode"),
        }
    }
}

impl core::error::Error for ParametersError {}
