//! Which operators a binary has, chosen by type.

use crate::plan::{LAYOUT_INT8, LAYOUT_TILES};

/// The kinds of operators.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum OpKind {
    /// [`super::EmbedEntities`].
    EmbedEntities,
    /// [`super::AttendOwn`].
    AttendOwn,
    /// [`super::Dense`].
    Dense,
    /// [`super::MaskedArgmax`].
    MaskedArgmax,
    /// [`super::Gru`].
    Gru,
    /// [`super::MaskedSample`].
    MaskedSample,
    /// [`super::AttendAll`].
    AttendAll,
    /// [`super::MeanRows`].
    MeanRows,
    /// [`super::GroupSum`].
    GroupSum,
    /// [`super::Output`].
    Output,
    /// [`super::Int8EmbedEntities`].
    Int8EmbedEntities,
    /// [`super::Int8AttendOwn`].
    Int8AttendOwn,
    /// [`super::Int8Dense`].
    Int8Dense,
    /// [`super::EmbedTasks`].
    EmbedTasks,
    /// [`super::PointerLogits`].
    PointerLogits,
    /// [`super::ScoreAllocations`].
    ScoreAllocations,
}

impl OpKind {
    /// Every kind.
    pub const ALL: &[Self] = &[
        Self::EmbedEntities,
        Self::AttendOwn,
        Self::Dense,
        Self::MaskedArgmax,
        Self::Gru,
        Self::MaskedSample,
        Self::AttendAll,
        Self::MeanRows,
        Self::GroupSum,
        Self::Output,
        Self::Int8EmbedEntities,
        Self::Int8AttendOwn,
        Self::Int8Dense,
        Self::EmbedTasks,
        Self::PointerLogits,
        Self::ScoreAllocations,
    ];

    /// Whether plans of this weight layout have the operator.
    pub(crate) const fn fits(self, layout: u32) -> bool {
        match self {
            Self::MaskedArgmax | Self::MaskedSample => true,
            Self::Int8EmbedEntities | Self::Int8AttendOwn | Self::Int8Dense => {
                layout == LAYOUT_INT8
            }
            _ => layout == LAYOUT_TILES,
        }
    }

    /// The operator's name, as reports show it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::EmbedEntities => "EmbedEntities",
            Self::AttendOwn => "AttendOwn",
            Self::Dense => "Dense",
            Self::MaskedArgmax => "MaskedArgmax",
            Self::Gru => "Gru",
            Self::MaskedSample => "MaskedSample",
            Self::AttendAll => "AttendAll",
            Self::MeanRows => "MeanRows",
            Self::GroupSum => "GroupSum",
            Self::Output => "Output",
            Self::Int8EmbedEntities => "Int8EmbedEntities",
            Self::Int8AttendOwn => "Int8AttendOwn",
            Self::Int8Dense => "Int8Dense",
            Self::EmbedTasks => "EmbedTasks",
            Self::PointerLogits => "PointerLogits",
            Self::ScoreAllocations => "ScoreAllocations",
        }
    }
}

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
