//! What is done where the policy does not answer.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What is done where the policy does not answer, or not in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Fallback {
    /// The last outputs and the last action once more; zeros before the first.
    #[default]
    Hold,
    /// Outputs of zeros, action 0.
    Zero,
    /// This action, and outputs of zeros.
    Action(u16),
}

impl Fallback {
    /// Replaces the last outputs; returns the action. One that is not available gives way to the first that is;
    /// `None` where none is, or the policy does not choose.
    pub(super) fn apply(
        self,
        outputs: &mut [f32],
        last: Option<u16>,
        available: &[u16],
    ) -> Option<u16> {
        let wanted = match self {
            Self::Hold => last,
            Self::Zero => Some(0),
            Self::Action(action) => Some(action),
        };
        if self != Self::Hold {
            outputs.fill(0.0);
        }
        let is_available = |action: &u16| available.get(usize::from(*action)) > Some(&0);
        let first = || (0..).zip(available).find(|(_, code)| **code != 0).map(|(action, _)| action);
        wanted.filter(is_available).or_else(first)
    }
}

impl fmt::Display for Fallback {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hold => f.write_str("hold"),
            Self::Zero => f.write_str("zero"),
            Self::Action(action) => write!(f, "{action}"),
        }
    }
}

impl FromStr for Fallback {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "hold" => Ok(Self::Hold),
            "zero" => Ok(Self::Zero),
            number => number
                .parse()
                .map(Self::Action)
                .map_err(|_| "expected `hold`, `zero`, or the number of an action"),
        }
    }
}

impl From<Fallback> for String {
    fn from(fallback: Fallback) -> Self {
        fallback.to_string()
    }
}

impl TryFrom<String> for Fallback {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fallback_is_available_or_gives_way() {
        let apply = |fallback: Fallback, last, available: &[u16]| {
            let mut outputs = [1.0, 2.0];
            (fallback.apply(&mut outputs, last, available), outputs)
        };
        let (held, zeros) = ([1.0, 2.0], [0.0; 2]);
        assert_eq!(apply(Fallback::Hold, Some(2), &[1, 1, 1]), (Some(2), held));
        assert_eq!(apply(Fallback::Hold, Some(2), &[0, 1, 0]), (Some(1), held));
        assert_eq!(apply(Fallback::Hold, None, &[0, 1, 1]), (Some(1), held));
        assert_eq!(apply(Fallback::Zero, Some(2), &[1, 1, 1]), (Some(0), zeros));
        assert_eq!(apply(Fallback::Action(1), Some(2), &[1, 1, 1]), (Some(1), zeros));
        assert_eq!(apply(Fallback::Action(9), Some(2), &[0, 0, 1]), (Some(2), zeros));
        assert_eq!(apply(Fallback::Action(1), None, &[0, 0]), (None, zeros));
        assert_eq!(apply(Fallback::Hold, None, &[]), (None, held));
    }

    #[test]
    fn a_fallback_is_read_as_it_is_written() {
        for fallback in [Fallback::Hold, Fallback::Zero, Fallback::Action(3)] {
            assert_eq!(fallback.to_string().parse(), Ok(fallback));
        }
        for text in ["", "still", "-1", "70000"] {
            assert!(text.parse::<Fallback>().is_err(), "{text}");
        }
    }
}
