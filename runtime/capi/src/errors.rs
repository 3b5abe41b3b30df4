//! What can be wrong, as C sees it.

use core::ffi::CStr;

use sortie_core::DecideError;
use sortie_core::plan::{GuardError, PlanError};

/// Why a function did nothing. `sortie_error_text` says what to do about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum SortieError {
    /// All is well.
    None = 0,
    /// A pointer is null.
    Null = 1,
    /// An address is not aligned.
    Misaligned = 2,
    /// Memory that is written is given twice.
    Overlap = 3,
    /// The pointer leads to no loaded policy.
    NoPolicy = 4,
    /// The bytes are no plan.
    NoPlan = 5,
    /// The plan has a format that this library does not read.
    Version = 6,
    /// The plan was written for the other byte order.
    Endian = 7,
    /// Bytes of the plan are missing.
    Truncated = 8,
    /// A checksum of the plan does not match.
    Damaged = 9,
    /// The plan was made for another machine: its weights are laid out otherwise, or its arithmetic is not available.
    OtherMachine = 10,
    /// The plan has an operator that this library does not have.
    UnknownOperator = 11,
    /// The plan contradicts itself.
    Inconsistent = 12,
    /// The plan is neither a policy's nor an agent's.
    WrongNetwork = 13,
    /// The memory for the policy is too small.
    MemoryTooSmall = 14,
    /// The function is for another kind of plan.
    WrongKind = 15,
    /// There are more or fewer inputs or outputs than the plan has.
    WrongCount = 16,
    /// An array is longer or shorter than the plan needs it.
    WrongLength = 17,
    /// More entities are visible, or given, than the plan takes.
    TooManyEntities = 18,
    /// No action is available.
    NoAvailableAction = 19,
    /// A number that was given, or one that came out, is not finite.
    NotFinite = 20,
    /// The policy chooses greedily: there is nothing to draw from.
    Greedy = 21,
    /// Something that this version of the header has no name for.
    Other = 22,
    /// The plan has no guards, or the pointer leads to none.
    NoGuards = 23,
    /// No guard has tripped: there is nothing to fall back from.
    NoTrip = 24,
}

impl SortieError {
    /// Every error, at the place of its number.
    const ALL: [Self; 25] = [
        Self::None,
        Self::Null,
        Self::Misaligned,
        Self::Overlap,
        Self::NoPolicy,
        Self::NoPlan,
        Self::Version,
        Self::Endian,
        Self::Truncated,
        Self::Damaged,
        Self::OtherMachine,
        Self::UnknownOperator,
        Self::Inconsistent,
        Self::WrongNetwork,
        Self::MemoryTooSmall,
        Self::WrongKind,
        Self::WrongCount,
        Self::WrongLength,
        Self::TooManyEntities,
        Self::NoAvailableAction,
        Self::NotFinite,
        Self::Greedy,
        Self::Other,
        Self::NoGuards,
        Self::NoTrip,
    ];

    /// The error of a number.
    pub(crate) fn of(number: i32) -> Option<Self> {
        Self::ALL.get(usize::try_from(number).ok()?).copied()
    }

    /// What is wrong, and what to do.
    pub(crate) const fn text(self) -> &'static CStr {
        match self {
            Self::None => c"all is well",
            Self::Null => c"a pointer is null: give memory for everything whose length is not 0",
            Self::Misaligned => {
                c"an address is not aligned: plans start at a multiple of 64 bytes (SORTIE_ALIGNED), arrays at one of their numbers' size"
            }
            Self::Overlap => {
                c"memory that is written is given twice: outputs, states, the decision, the policy's memory and the plan lie apart"
            }
            Self::NoPolicy => {
                c"this is no loaded policy: give the pointer that sortie_load wrote, and do not move or overwrite its memory"
            }
            Self::NoPlan => c"these bytes are no plan: make one with `sortie compile`",
            Self::Version => c"the plan's format is not readable here: compile the network again",
            Self::Endian => c"the plan was written for the other byte order: it cannot run here",
            Self::Truncated => c"the plan is cut off: give all bytes of the file",
            Self::Damaged => c"the plan is damaged: copy it again, or compile the network again",
            Self::OtherMachine => {
                c"the plan is for another machine: compile the network with `--profile exact`"
            }
            Self::UnknownOperator => {
                c"the plan has an operator that this library does not have: build a newer library"
            }
            Self::Inconsistent => {
                c"the sizes of the plan do not fit each other: compile the network again"
            }
            Self::WrongNetwork => {
                c"the plan is neither a policy's nor an agent's: this library runs no other"
            }
            Self::MemoryTooSmall => {
                c"the memory is too small: ask sortie_memory_bytes how much the policy needs"
            }
            Self::WrongKind => {
                c"the function is for other plans: agents take sortie_decide, policies sortie_respond, those with actions also sortie_choose"
            }
            Self::WrongCount => {
                c"the number of inputs or outputs is not the plan's: ask sortie_input_count and sortie_output_count"
            }
            Self::WrongLength => {
                c"an array is not of the plan's length, or an index lies outside: ask sortie_input_length, sortie_output_length, sortie_state_numbers, sortie_actions, sortie_features"
            }
            Self::TooManyEntities => {
                c"there are more entities than the plan takes: ask sortie_most_entities, or compile the network with a larger `--n-max`"
            }
            Self::NoAvailableAction => c"no action is available: leave at least one",
            Self::NotFinite => {
                c"a number is not finite: look for NaN and infinities in inputs and states"
            }
            Self::Greedy => c"the policy chooses greedily: use sortie_choose or sortie_decide",
            Self::NoGuards => {
                c"there are no guards: compile the network with `--guards`, give the pointer that sortie_guard wrote, and do not move or overwrite its memory"
            }
            Self::NoTrip => {
                c"no guard has tripped: fall back only where the trip names one, or say SORTIE_GUARD_UNDECIDED"
            }
            Self::Other => c"something is wrong that this version has no name for: build a newer library",
        }
    }
}

impl From<PlanError> for SortieError {
    fn from(error: PlanError) -> Self {
        match error {
            PlanError::BadMagic => Self::NoPlan,
            PlanError::Version { .. } => Self::Version,
            PlanError::Endian => Self::Endian,
            PlanError::Truncated { .. } => Self::Truncated,
            PlanError::Crc(_) => Self::Damaged,
            PlanError::Misaligned { .. } => Self::Misaligned,
            PlanError::WrongLayout { .. } | PlanError::WrongProfile { .. } => Self::OtherMachine,
            PlanError::UnknownOp => Self::UnknownOperator,
            PlanError::ShapeMismatch { .. } => Self::Inconsistent,
            PlanError::WrongNetwork => Self::WrongNetwork,
            PlanError::ArenaTooSmall { .. } => Self::MemoryTooSmall,
            _ => Self::Other,
        }
    }
}

impl From<GuardError> for SortieError {
    fn from(error: GuardError) -> Self {
        match error {
            GuardError::Plan(error) => error.into(),
            GuardError::Damaged => Self::Damaged,
            GuardError::Version { .. } => Self::Version,
            _ => Self::Inconsistent,
        }
    }
}

impl From<DecideError> for SortieError {
    fn from(error: DecideError) -> Self {
        match error {
            DecideError::TooManyEntities { .. } => Self::TooManyEntities,
            DecideError::BadLength
            | DecideError::HiddenState { .. }
            | DecideError::NoSuchRow { .. } => Self::WrongLength,
            DecideError::NoAvailableAction => Self::NoAvailableAction,
            DecideError::NonFinite => Self::NotFinite,
            DecideError::Greedy => Self::Greedy,
            _ => Self::Other,
        }
    }
}

impl From<Result<(), Self>> for SortieError {
    fn from(result: Result<(), Self>) -> Self {
        result.err().unwrap_or(Self::None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_stands_at_its_number_and_says_something_else() {
        for (number, error) in SortieError::ALL.into_iter().enumerate() {
            assert_eq!(error as usize, number);
            assert_eq!(SortieError::of(number as i32), Some(error));
            let texts = SortieError::ALL.map(SortieError::text);
            assert_eq!(texts.iter().filter(|text| **text == error.text()).count(), 1);
        }
        for number in [-1, SortieError::ALL.len() as i32, i32::MIN, i32::MAX] {
            assert_eq!(SortieError::of(number), None);
        }
    }
}
