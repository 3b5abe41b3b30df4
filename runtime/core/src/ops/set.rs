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

/// What policies over inputs of fixed sizes need.
#[derive(Clone, Copy, Debug)]
pub struct Policies;

impl OperatorSet for Policies {
    const OPERATORS: &[OpKind] = &[
        OpKind::Dense,
        OpKind::MaskedArgmax,
        OpKind::Gru,
        OpKind::MaskedSample,
        OpKind::Output,
        OpKind::Int8Dense,
        OpKind::Input,
        OpKind::State,
        OpKind::Constant,
        OpKind::Map,
        OpKind::Combine,
        OpKind::Select,
        OpKind::Arrange,
        OpKind::Reduce,
        OpKind::Softmax,
        OpKind::Normalise,
        OpKind::Multiply,
        OpKind::GruCell,
        OpKind::LstmCell,
        OpKind::Convolve,
        OpKind::DenseRows,
        OpKind::LookUp,
        OpKind::ConvolvePatches,
        OpKind::FoldPatches,
        OpKind::Int8ConvolvePatches,
    ];
}

#[cfg(test)]
mod tests {
    use super::super::table::{has, has_all};
    use super::*;

    #[test]
    fn policies_have_every_step() {
        let beside = [
            OpKind::Dense,
            OpKind::Int8Dense,
            OpKind::Gru,
            OpKind::Output,
            OpKind::MaskedArgmax,
            OpKind::MaskedSample,
        ];
        for &kind in OpKind::ALL {
            let of_policies = kind.is_step() || beside.contains(&kind);
            assert_eq!(has::<Policies>(kind), of_policies, "{}", kind.name());
        }
    }

    #[test]
    fn a_set_has_what_it_names() {
        for &kind in OpKind::ALL {
            assert!(has::<AllOperators>(kind), "{}", kind.name());
            assert_eq!(has::<FeedForward>(kind), FeedForward::OPERATORS.contains(&kind));
        }
        assert!(!has::<FeedForward>(OpKind::Gru));
        assert!(has_all::<AllOperators>() && !has_all::<Policies>());
    }
}
