//! The table of operators, from which all that is said of each comes.

use zerocopy::{IntoBytes, TryFromBytes};

use super::operator::Operator;
use super::team::Team;
use super::{
    Arrange, AttendAll, AttendOwn, Combine, Constant, Convolve, ConvolvePatches, Dense, DenseRows,
    EmbedEntities, EmbedTasks, FoldPatches, GroupSum, Gru, GruCell, Input, Int8AttendOwn,
    Int8ConvolvePatches, Int8Dense, Int8EmbedEntities, Int8PointAtEntities, LookUp, LstmCell, Map,
    MaskedArgmax, MaskedSample, MeanRows, Multiply, Normalise, Output, Places, PointAtEntities,
    PointerLogits, Reduce, ScoreAllocations, Scratch, Select, Sizes, Softmax, State,
};
use crate::kernels::Kernels;
use crate::limits;
use crate::policy::{DecideError, Observation};

/// The operators that a plan may use; code of the others is never linked through it.
///
/// A host takes [`AllOperators`](super::AllOperators) and runs every plan. Where flash is short, name what the plan needs:
///
/// ```
/// use sortie_core::operators::{OpKind, OperatorSet};
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

/// Whether `S` lacks no operator.
pub(crate) const fn has_all<S: OperatorSet>() -> bool {
    let mut kinds = OpKind::ALL;
    while let [first, rest @ ..] = kinds {
        if !has::<S>(*first) {
            return false;
        }
        kinds = rest;
    }
    true
}

/// Whether an operator of `S` runs where there are steps of policies, or are none.
const fn runs<S: OperatorSet, const STEPS: bool>(kind: OpKind) -> bool {
    has::<S>(kind) && (STEPS || !kind.is_step())
}

/// Makes [`Op`], [`OpRef`] and [`OpKind`] of operators, whose order is that of their numbers in a plan.
macro_rules! operators {
    ($($(#[$doc:meta])* $kind:ident,)*) => {
        /// One operator, of which compilers build programs.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum Op {
            $($(#[$doc])* $kind($kind),)*
        }

        /// One operator, where it stands in a program.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum OpRef<'a> {
            $($(#[$doc])* $kind(&'a $kind),)*
        }

        /// The kinds of operators.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum OpKind {
            $(#[doc = concat!("[`super::", stringify!($kind), "`].")] $kind,)*
        }

        impl OpKind {
            /// Every kind.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// The operator's name, as reports show it.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$kind => stringify!($kind),)* }
            }

            /// The layout of the weights in plans that have the operator; `None` = any.
            const fn layout(self) -> Option<u32> {
                match self { $(Self::$kind => <$kind as Operator>::LAYOUT,)* }
            }
        }

        impl Op {
            /// The operator, borrowed.
            pub const fn borrow(&self) -> OpRef<'_> {
                match self { $(Self::$kind(op) => OpRef::$kind(op),)* }
            }
        }

        impl<'a> OpRef<'a> {
            /// Reads the fields of an operator of the set `S` where they stand; `None` where there is no such operator,
            /// or its fields are none.
            #[inline(always)]
            pub(crate) fn read<S: OperatorSet>(kind: u16, fields: &'a [u8]) -> Option<Self> {
                $(if const { has::<S>(OpKind::$kind) } && kind == OpKind::$kind as u16 {
                    return $kind::try_ref_from_bytes(fields).ok().map(Self::$kind);
                })*
                None
            }

            /// The fields as a plan holds them, whole words.
            pub fn fields(self) -> &'a [u8] {
                match self { $(Self::$kind(op) => op.as_bytes(),)* }
            }

            /// The operator by itself.
            pub const fn to_op(self) -> Op {
                match self { $(Self::$kind(op) => Op::$kind(*op),)* }
            }

            /// The operator's kind.
            pub const fn kind(self) -> OpKind {
                match self { $(Self::$kind(_) => OpKind::$kind,)* }
            }

            /// Whether every place lies inside and sizes agree.
            pub(crate) fn check<S: OperatorSet>(self, sizes: &Sizes) -> bool {
                match self {
                    $(Self::$kind(op) if const { has::<S>(OpKind::$kind) } => op.check(sizes),)*
                    _ => false,
                }
            }

            /// What it reads of a policy's values.
            pub(crate) fn reads(self) -> Places {
                match self { $(Self::$kind(op) => op.reads(),)* }
            }

            /// What it writes of them.
            pub(crate) fn writes(self) -> Places {
                match self { $(Self::$kind(op) => op.writes(),)* }
            }

            /// Multiply-adds of one decision with `visible` entities, zeros not left out.
            pub fn multiply_adds(self, visible: usize) -> u64 {
                // No plan takes more; so nothing overflows.
                let visible = visible.min(limits::ENTITIES) as u64;
                match self { $(Self::$kind(op) => op.multiply_adds(visible),)* }
            }

            /// Runs the operator if it is of the set `S`, and no step of a policy unless `STEPS` says so; the code of
            /// others is not linked. Networks without steps so keep a loop that is short enough for the registers.
            #[inline(always)]
            pub(crate) fn run<S: OperatorSet, const STEPS: bool>(
                self,
                kernels: impl Kernels,
                weights: &[f32],
                observation: &Observation<'_>,
                scratch: &mut Scratch<'_>,
            ) -> Result<(), DecideError> {
                match self {
                    $(Self::$kind(op) if const { runs::<S, STEPS>(OpKind::$kind) } => {
                        op.run(kernels, weights, observation, scratch)
                    })*
                    // Loading refused it.
                    _ => Err(DecideError::BadLength),
                }
            }

            /// Whether the operator can work for a team, whose members' own places lie behind the first
            /// `shared` floats.
            pub(crate) fn works_for_teams(self, shared: u32) -> bool {
                match self { $(Self::$kind(op) => op.works_for_teams(shared),)* }
            }

            /// As [`Self::run`] for all members of a team, whose observations are of one frame.
            #[inline(always)]
            pub(crate) fn run_team<S: OperatorSet>(
                self,
                kernels: impl Kernels,
                weights: &[f32],
                observations: &[Observation<'_>],
                team: &mut Team<'_>,
            ) -> Result<(), DecideError> {
                match self {
                    $(Self::$kind(op) if const { has::<S>(OpKind::$kind) } => {
                        op.run_team(kernels, weights, observations, team)
                    })*
                    // Loading refused it.
                    _ => Err(DecideError::BadLength),
                }
            }
        }
    };
}

operators! {
    /// The first layer, on visible rows.
    EmbedEntities,
    /// Attention of the agent's own query.
    AttendOwn,
    /// A layer on one vector.
    Dense,
    /// The choice of the action; its input is the program's utilities.
    MaskedArgmax,
    /// What the agent remembers.
    Gru,
    /// The draw of the action; its input is the program's logits.
    MaskedSample,
    /// Attention of every entity's query.
    AttendAll,
    /// The mean of some rows.
    MeanRows,
    /// Sums of rows, one for every group.
    GroupSum,
    /// What the caller reads.
    Output,
    /// The first layer, on visible rows, of int8 weights.
    Int8EmbedEntities,
    /// Attention of the agent's own query, of int8 weights.
    Int8AttendOwn,
    /// A layer on one vector, of int8 weights.
    Int8Dense,
    /// The trunk of an allocator that proposes.
    EmbedTasks,
    /// Its step.
    PointerLogits,
    /// Its critic.
    ScoreAllocations,
    /// What the caller of a policy gives.
    Input,
    /// What a policy remembers.
    State,
    /// Numbers of the weights.
    Constant,
    /// A function of every number.
    Map,
    /// A function of two values.
    Combine,
    /// One of two values.
    Select,
    /// Numbers in another order.
    Arrange,
    /// One number of every row.
    Reduce,
    /// The softmax of every row.
    Softmax,
    /// Layer normalisation.
    Normalise,
    /// The product of two values.
    Multiply,
    /// A gated recurrent unit behind its products.
    GruCell,
    /// A long short-term memory behind its products.
    LstmCell,
    /// A layer on every patch of a picture.
    Convolve,
    /// A layer on every row of a value.
    DenseRows,
    /// Rows of tables.
    LookUp,
    /// A layer on every patch of a picture, its sums in registers.
    ConvolvePatches,
    /// One number of every channel of every patch.
    FoldPatches,
    /// A layer on every patch of a picture, of int8 weights.
    Int8ConvolvePatches,
    /// Utilities of actions that are aimed at entities.
    PointAtEntities,
    /// Utilities of actions that are aimed at entities, of integers.
    Int8PointAtEntities,
}

impl OpKind {
    /// Whether it is a part of an allocator that proposes, and of nothing else.
    pub(crate) const fn is_of_proposals(self) -> bool {
        matches!(self, Self::EmbedTasks | Self::PointerLogits | Self::ScoreAllocations)
    }

    /// Whether it stands in policies alone.
    pub(crate) const fn is_step(self) -> bool {
        self as u16 >= Self::Input as u16 && !self.points()
    }

    /// Whether it points at entities, which policies over inputs of fixed sizes do not know.
    const fn points(self) -> bool {
        matches!(self, Self::PointAtEntities | Self::Int8PointAtEntities)
    }

    /// Whether plans of this weight layout have the operator.
    pub(crate) const fn fits(self, layout: u32) -> bool {
        match self.layout() {
            Some(own) => own == layout,
            None => true,
        }
    }
}

impl OpRef<'_> {
    /// The operator's name, as reports show it.
    pub const fn name(self) -> &'static str {
        self.kind().name()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Flag, Linear, Place, RowAttention};
    use super::*;

    #[test]
    fn the_largest_operators_can_be_counted_on_any_host() {
        let place = Place { offset: 0, len: u32::MAX };
        let most = u16::MAX;
        let layer = Linear { inputs: most, outputs: most, weights: 0, bias: 0 };
        let attention = RowAttention {
            heads: most.into(),
            query: layer,
            key: layer,
            value: layer,
            output: layer,
        };
        let vectors = super::super::Vectors { weights: 0, count: most, width: most };
        let all = Op::AttendAll(AttendAll {
            rows: place,
            width: most,
            heads: most,
            query: layer,
            key: layer,
            value: layer,
            output: layer,
            relu: Flag::Yes,
            queries: place,
            keys: place,
            values: place,
            scores: place,
            attended: place,
            to: place,
        });
        let critic = Op::ScoreAllocations(ScoreAllocations {
            embed: layer,
            tasks: vectors,
            counts: vectors,
            attention,
            head: layer,
        });
        let matrix = 65_535 * 65_536_u64;
        let of_rows = |rows: u64| 4 * rows * matrix + 2 * rows * rows * 65_535;
        assert_eq!(all.borrow().multiply_adds(2), of_rows(2));
        assert_eq!(all.borrow().multiply_adds(usize::MAX), of_rows(limits::ENTITIES as u64));
        assert_eq!(critic.borrow().multiply_adds(3), 3 * matrix + of_rows(3) + matrix);
    }
}
