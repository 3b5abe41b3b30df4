//! Which guard of a policy tripped, and why a plan's guards cannot be used.

use super::PlanError;

/// The guard that tripped. Indices count the numbers of all inputs, or of all outputs, in the plan's order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Trip {
    /// An input lies outside of its range, or is NaN.
    InputRange {
        /// Which number.
        index: u32,
    },
    /// The observation is older than it may be.
    Age,
    /// An output is NaN or infinite.
    OutputNotFinite {
        /// Which number.
        index: u32,
    },
    /// An output lies below its lowest or above its highest value.
    OutputRange {
        /// Which number.
        index: u32,
    },
    /// An output is further from the last one given out than it may change by.
    OutputRate {
        /// Which number.
        index: u32,
    },
    /// There are more or fewer numbers than the guards are about.
    Length,
    /// The network has not answered.
    Undecided,
    /// No guard now: one that tripped before is held.
    Held,
}

impl Trip {
    /// Its name for scripts: `input_range`, `age`, `output_not_finite`, `output_range`, `output_rate`, `length`,
    /// `undecided`, `held`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::InputRange { .. } => "input_range",
            Self::Age => "age",
            Self::OutputNotFinite { .. } => "output_not_finite",
            Self::OutputRange { .. } => "output_range",
            Self::OutputRate { .. } => "output_rate",
            Self::Length => "length",
            Self::Undecided => "undecided",
            Self::Held => "held",
        }
    }

    /// Which input or output, where it is about one.
    pub const fn index(self) -> Option<u32> {
        match self {
            Self::InputRange { index }
            | Self::OutputNotFinite { index }
            | Self::OutputRange { index }
            | Self::OutputRate { index } => Some(index),
            _ => None,
        }
    }

    /// The number in messages: the kind in the lowest eight bits, the index above. Never 0, which stands for none.
    pub const fn number(self) -> u32 {
        let kind = match self {
            Self::InputRange { .. } => 1,
            Self::Age => 2,
            Self::OutputNotFinite { .. } => 3,
            Self::OutputRange { .. } => 4,
            Self::OutputRate { .. } => 5,
            Self::Length => 6,
            Self::Undecided => 7,
            Self::Held => 8,
        };
        match self.index() {
            Some(index) => kind | index << 8,
            None => kind,
        }
    }

    /// The trip of a number, if there is one.
    pub const fn from_number(number: u32) -> Option<Self> {
        let index = number >> 8;
        Some(match number & 0xFF {
            1 => Self::InputRange { index },
            2 => Self::Age,
            3 => Self::OutputNotFinite { index },
            4 => Self::OutputRange { index },
            5 => Self::OutputRate { index },
            6 => Self::Length,
            7 => Self::Undecided,
            8 => Self::Held,
            _ => return None,
        })
    }
}

impl core::fmt::Display for Trip {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::InputRange { index } => write!(f, "input {index} is outside of its range"),
            Self::Age => f.write_str("the observation is too old"),
            Self::OutputNotFinite { index } => write!(f, "output {index} is no finite number"),
            Self::OutputRange { index } => write!(f, "output {index} is outside of its range"),
            Self::OutputRate { index } => write!(f, "output {index} changes too fast"),
            Self::Length => f.write_str("the guards are about another number of inputs or outputs"),
            Self::Undecided => f.write_str("the network has not answered"),
            Self::Held => f.write_str("the guard that tripped before is held"),
        }
    }
}

impl core::error::Error for Trip {}

/// Why a plan's guards cannot be used. Whoever would guard with them does not run the plan then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum GuardError {
    /// The bytes are no plan.
    Plan(PlanError),
    /// Something behind the weights is cut off or changed: it may be the guards.
    Damaged,
    /// The guards have a form that this reader does not know.
    Version {
        /// The number of the form.
        got: u8,
    },
    /// A lowest value is above its highest, a limit is NaN, or a change is negative.
    Contradiction,
    /// They are about another number of inputs.
    Inputs {
        /// Numbers of all inputs.
        want: usize,
        /// Those that are guarded.
        got: usize,
    },
    /// They are about another number of outputs.
    Outputs {
        /// Numbers of all outputs.
        want: usize,
        /// Those that are guarded.
        got: usize,
    },
}

impl core::fmt::Display for GuardError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Plan(error) => error.fmt(f),
            Self::Damaged => {
                f.write_str("guards may be missing: what stands behind the plan's weights is cut off or changed")
            }
            Self::Version { got } => write!(f, "the plan's guards have the unknown form {got}"),
            Self::Contradiction => f.write_str("the plan's guards contradict themselves"),
            Self::Inputs { want, got } => {
                write!(f, "the plan has {want} numbers in all inputs, its guards are about {got}")
            }
            Self::Outputs { want, got } => {
                write!(f, "the plan has {want} numbers in all outputs, its guards are about {got}")
            }
        }
    }
}

impl core::error::Error for GuardError {}

impl From<PlanError> for GuardError {
    fn from(error: PlanError) -> Self {
        Self::Plan(error)
    }
}
