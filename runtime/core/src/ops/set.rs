//! Which operators a binary has, chosen by type.

use super::OpKind;

/// The operators that a plan may use; code of the others is never linked through it.
///
/// A host takes [`AllOperators`] and runs every plan. Where flash is short, name what the plan needs:
///
/// ```
/// use sortie_core::ops::{OpKind, OperatorSet};
///
/// #[derive(Clone, Copy, Debug)]
/// struct Mine;
///
/// impl OperatorSet for Mine {
///     const OPERATORS: &[OpKind] =
///         &[OpKind::EmbedEntities, OpKind::AttendOwn, OpKind::Dense, OpKind::MaskedArgmax];
/// }
/// ```
pub trait OperatorSet: Copy + core::fmt::Debug {
    /// The operators of the set.
    const OPERATORS: &[OpKind];
}

/// Every operator of this crate.
#[derive(Clone, Copy, Debug)]
pub struct AllOperators;

impl OperatorSet for AllOperators {
    const OPERATORS: &[OpKind] = OpKind::ALL;
}

/// What feed-forward agents and team values need.
#[derive(Clone, Copy, Debug)]
pub struct FeedForward;

impl OperatorSet for FeedForward {
    const OPERATORS: &[OpKind] =
        &[OpKind::EmbedEntities, OpKind::AttendOwn, OpKind::Dense, OpKind::MaskedArgmax];
}

/// What feed-forward agents with int8 weights need.
#[derive(Clone, Copy, Debug)]
pub struct Int8FeedForward;

impl OperatorSet for Int8FeedForward {
    const OPERATORS: &[OpKind] = &[
        OpKind::Int8EmbedEntities,
        OpKind::Int8AttendOwn,
        OpKind::Int8Dense,
        OpKind::MaskedArgmax,
    ];
}

/// Whether `kind` is among the operators of `S`; constant, so that what is missing is not linked.
pub(crate) const fn has<S: OperatorSet>(kind: OpKind) -> bool {
    let mut kinds = S::OPERATORS;
    while let [first, rest @ ..] = kinds {
        if *first as u8 == kind as u8 {
            return true;
        }
        kinds = rest;
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_has_what_it_names() {
        for &kind in OpKind::ALL {
            assert!(has::<AllOperators>(kind), "{}", kind.name());
            assert_eq!(has::<FeedForward>(kind), FeedForward::OPERATORS.contains(&kind));
        }
        assert!(!has::<FeedForward>(OpKind::Gru));
    }
}
