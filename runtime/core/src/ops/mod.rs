//! The macro-operators of a plan, by subject: what they need, how they are checked, what they compute.
//!
//! An operator names its places in the weights and in the arena as offsets in floats. `OpRef::check` proves once,
//! at load, that all of them lie inside and that what is written is not read by the same step; execution then
//! only takes slices that exist, and still answers with an error where one does not.

mod attend_all;
mod attend_own;
mod attend_own_shared;
mod choice;
mod dense;
mod embed_entities;
mod group_sum;
mod gru;
mod int8_attend_own;
mod int8_dense;
mod int8_embed_entities;
mod int8_layer;
mod int8_patches;
mod int8_rows;
mod mean_rows;
mod operator;
mod output;
mod place;
mod point;
mod proposals;
mod set;
mod steps;
mod table;
pub(crate) mod team;

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

pub use attend_all::AttendAll;
pub use attend_own::AttendOwn;
pub use choice::{MaskedArgmax, MaskedSample};
pub use dense::Dense;
pub use embed_entities::EmbedEntities;
pub use group_sum::GroupSum;
pub use gru::Gru;
pub use int8_attend_own::Int8AttendOwn;
pub use int8_dense::Int8Dense;
pub use int8_embed_entities::Int8EmbedEntities;
pub use int8_layer::{Int8Layer, quantised_floats};
pub use int8_patches::{Int8ConvolvePatches, quantised_picture};
pub use mean_rows::{MeanRows, Members};
pub use output::{Output, OutputRows};
pub use place::Place;
pub(crate) use place::{Places, apart, copied, place, places};
pub use point::{Int8PointAtEntities, PointAtEntities, Targets};
pub(crate) use proposals::{COUNTS, arena as proposal_arena};
pub use proposals::{
    EmbedTasks, PointerLogits, ProposalNetwork, RowAttention, ScoreAllocations, Vectors,
};
pub use set::{AllOperators, FeedForward, Int8FeedForward, Policies};
pub use steps::{
    Arrange, Choice, Combination, Combine, Constant, Convolve, ConvolvePatches, DenseRows,
    FoldPatches, Function, GruCell, Input, LookUp, LstmCell, Map, Meaning, Multiply, Normalise,
    Reduce, Reduction, Select, Softmax, State,
};
pub use table::{Op, OpKind, OpRef, OperatorSet};
pub(crate) use table::{has, has_all};

use crate::entity_mask::EntityMask;
use crate::kernels::mark::{MARKED, Marks};
pub use crate::kernels::patches::{Fold, Patches};
use crate::kernels::product::{Around, padded};
use crate::policy::DecideError;

/// Layout 1 of weights: f32 in tiles of 64 columns.
pub const LAYOUT_TILES: u32 = 1;
/// Layout 3 of weights: int8 in strips of 16 columns, pairs of inputs side by side; steps and biases f32.
pub const LAYOUT_INT8_PAIRS: u32 = 3;
/// Layout 4 of weights: as 3, for the DSP extension; of every four bytes of int8 the two in the middle are exchanged.
pub const LAYOUT_INT8_DSP: u32 = 4;
/// The layout of int8 weights that this build reads.
pub const LAYOUT_INT8: u32 = if cfg!(all(feature = "dsp", target_arch = "arm")) {
    LAYOUT_INT8_DSP
} else {
    LAYOUT_INT8_PAIRS
};

/// The sizes of a plan that its operators are checked against.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Floats of the arena.
    pub floats: u32,
    /// Marks that the arena holds, each of 64 inputs.
    pub nonzeros: u32,
    /// Floats of the weights.
    pub weights: u32,
    /// Most visible entities.
    pub n_max: u32,
    /// Features d of an entity.
    pub features: u32,
    /// Actions U.
    pub actions: u32,
    /// Floats of the recurrent state, 0 if there is none.
    pub hidden: u32,
}

impl Sizes {
    fn holds_weights(&self, offset: u32, len: u64) -> bool {
        u64::from(offset).saturating_add(len) <= u64::from(self.weights)
    }

    fn holds(&self, place: &Place) -> bool {
        u64::from(place.offset) + u64::from(place.len) <= u64::from(self.floats)
    }

    /// Whether all places lie inside and no two overlap.
    fn hold_apart(&self, places: &[&Place]) -> bool {
        places.iter().enumerate().all(|(index, place)| {
            self.holds(place) && places.iter().skip(index + 1).all(|other| place.disjoint(other))
        })
    }

    /// Whether two places lie inside and are the same or do not overlap.
    fn hold_in_place(&self, from: &Place, to: &Place) -> bool {
        self.holds(from) && self.holds(to) && (from == to || from.disjoint(to))
    }

    /// Whether a place has room for a row of `width` floats for every entity.
    fn holds_rows(&self, place: &Place, width: usize) -> bool {
        u64::from(place.len) >= u64::from(self.n_max).saturating_mul(width as u64)
    }

    fn lists(&self, inputs: u64) -> bool {
        inputs.div_ceil(MARKED as u64) <= u64::from(self.nonzeros)
    }
}

/// Yes or no, as a plan holds it: in a word of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u32)]
pub enum Flag {
    /// It is not so.
    No,
    /// It is so.
    Yes,
}

impl Flag {
    /// Whether it is so.
    pub const fn is_set(self) -> bool {
        matches!(self, Self::Yes)
    }
}

impl From<bool> for Flag {
    fn from(set: bool) -> Self {
        if set { Self::Yes } else { Self::No }
    }
}

/// A matrix with bias: offsets into the weights, sizes as the network means them, before padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Linear {
    /// Inputs.
    pub inputs: u16,
    /// Outputs.
    pub outputs: u16,
    /// Tiles of the matrix (see [`crate::kernels::product`]).
    pub weights: u32,
    /// Bias, padded like the outputs.
    pub bias: u32,
}

impl Linear {
    /// Outputs rounded up to whole tiles.
    pub const fn padded_outputs(&self) -> usize {
        padded(self.outputs as usize)
    }

    /// Floats of the matrix.
    pub const fn weights_len(&self) -> usize {
        (self.inputs as usize).saturating_mul(self.padded_outputs())
    }

    /// Multiply-adds of one product.
    fn multiply_adds(&self) -> u64 {
        u64::from(self.inputs) * self.padded_outputs() as u64
    }

    fn check(&self, sizes: &Sizes) -> bool {
        self.inputs > 0
            && self.outputs > 0
            && sizes.holds_weights(self.weights, self.weights_len() as u64)
            && sizes.holds_weights(self.bias, self.padded_outputs() as u64)
    }

    #[inline(always)]
    pub(crate) fn matrix<'w>(&self, weights: &'w [f32]) -> Result<&'w [f32], DecideError> {
        slice(weights, self.weights, self.weights_len())
    }

    /// Bias and ReLU of the layer.
    #[inline(always)]
    pub(crate) fn around<'w>(
        &self,
        weights: &'w [f32],
        relu: bool,
    ) -> Result<Around<'w>, DecideError> {
        let bias = slice(weights, self.bias, self.padded_outputs())?;
        Ok(Around { bias: Some(bias), relu })
    }
}

/// The arena of one decision, and what the operators tell each other.
pub(crate) struct Scratch<'a> {
    pub(crate) floats: &'a mut [f32],
    /// Marks the inputs of a sparse product.
    pub(crate) nonzeros: &'a mut [Marks],
    /// Visible entities, whose embeddings stand in rows 0 to `visible`.
    pub(crate) visible: usize,
    /// The row of the agent's own embedding, `visible` where it does not see itself.
    pub(crate) own: usize,
    /// The entities whose rows are embedded, in this order.
    pub(crate) present: EntityMask,
    /// The agents among all entities.
    pub(crate) agents: EntityMask,
    /// The groups of every entity.
    pub(crate) groups: &'a [u32],
    /// The inputs of a policy; none where it observes as an agent of a team.
    pub(crate) inputs: Option<&'a [&'a [f32]]>,
    /// Features d of an entity.
    pub(crate) features: usize,
    /// Most entities N.
    pub(crate) most: usize,
}

#[inline(always)]
fn slice(weights: &[f32], offset: u32, len: usize) -> Result<&[f32], DecideError> {
    let start = offset as usize;
    weights.get(start..start.saturating_add(len)).ok_or(DecideError::BadLength)
}
