//! Why a plan is refused.

/// A part of a plan that a checksum covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "std", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Part {
    /// Header and program.
    Program,
    /// Weights.
    Weights,
}

/// Why a plan cannot be loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "std", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PlanError {
    /// The bytes are not a plan.
    BadMagic,
    /// The plan's format is newer than this reader, or of another major version.
    Version {
        /// The plan's major version.
        major: u16,
        /// The plan's minor version.
        minor: u16,
    },
    /// The plan was written for the other byte order.
    Endian,
    /// Bytes are missing.
    Truncated {
        /// Bytes needed.
        need: usize,
        /// Bytes given.
        got: usize,
    },
    /// A checksum does not match: the plan is damaged.
    Crc(Part),
    /// The plan or the arena does not start at a multiple of the needed alignment.
    Misaligned {
        /// Alignment needed, in bytes.
        need: usize,
        /// Largest alignment that the address has, in bytes.
        got: usize,
    },
    /// The weights are laid out for another kind of machine.
    WrongLayout {
        /// The plan's layout id.
        got: u32,
    },
    /// The arithmetic profile is none that this build runs on this machine: fused multiply-add without the
    /// feature `std`, or where the processor has none.
    WrongProfile {
        /// The plan's profile.
        got: u8,
    },
    /// The program holds an operator that this build does not have.
    UnknownOp,
    /// Sizes or places of the program do not fit each other.
    ShapeMismatch {
        /// Index of the operator.
        op: usize,
    },
    /// The plan computes something else than what is asked of it: an agent's is none of an allocator.
    WrongNetwork,
    /// The arena is too small.
    ArenaTooSmall {
        /// Bytes needed.
        need: usize,
        /// Bytes given.
        got: usize,
    },
}

impl core::fmt::Display for PlanError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::BadMagic => f.write_str("this is not a plan"),
            Self::Version { major, minor } => {
                write!(
                    f,
                    "plan format {major}.{minor} is not readable here: compile the plan again"
                )
            }
            Self::Endian => f.write_str("the plan was written for the other byte order"),
            Self::Truncated { need, got } => {
                write!(f, "the plan is cut off: it needs {need} bytes and has {got}")
            }
            Self::Crc(Part::Program) => f.write_str("the plan's header or program is damaged"),
            Self::Crc(Part::Weights) => f.write_str("the plan's weights are damaged"),
            Self::Misaligned { need, got } => {
                write!(f, "must start at a multiple of {need} bytes, starts at one of {got}")
            }
            Self::WrongLayout { got } => {
                write!(
                    f,
                    "weight layout {got} is for another machine: compile the plan for this one"
                )
            }
            Self::WrongProfile { got } => {
                let name = match got {
                    1 => " (fused multiply-add): compile the plan with profile `exact`",
                    _ => "",
                };
                write!(f, "this build on this machine does not run arithmetic profile {got}{name}")
            }
            Self::UnknownOp => {
                f.write_str("the program has an operator that this build does not have")
            }
            Self::ShapeMismatch { op } => write!(f, "the sizes of operator {op} do not fit"),
            Self::WrongNetwork => {
                f.write_str("the plan is of another network: agents and allocators have their own")
            }
            Self::ArenaTooSmall { need, got } => {
                write!(f, "the arena needs {need} bytes and has {got}")
            }
        }
    }
}

impl core::error::Error for PlanError {}
