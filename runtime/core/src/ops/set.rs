//! Sets of operators for the usual plans.

use super::{OpKind, OperatorSet};

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

#[cfg(test)]
mod tests {
    use super::super::table::has;
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
