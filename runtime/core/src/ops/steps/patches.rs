//! Layers on the patches of a picture: convolutions and pools.
//!
//! Where patches start and results go is told in steps, so that pictures may stand point behind point, the channels of a point side by
//! side, as results do, or channel behind channel, as callers give them. A padded picture has its border around it.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Flag, LAYOUT_TILES, Place, Places, Scratch, Sizes, places, slice};
use crate::kernels::Kernels;
use crate::kernels::patches::{Fold, PatchLayer, Patches};
use crate::kernels::product::Around;
use crate::kernels::several::PART;
use crate::policy::{DecideError, Observation};

/// Outputs of a tile.
const TILE: u64 = PART as u64;

/// A layer on every patch, with a ReLU where one follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct ConvolvePatches {
    /// Tiles of 16 outputs, each with a row for every number of a patch.
    pub weights: u32,
    /// Bias, whole tiles.
    pub bias: u32,
    /// Outputs: numbers side by side for every patch.
    pub outputs: u32,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// The patches.
    pub patches: Patches,
    /// The picture.
    pub from: Place,
    /// The result, apart from it. What lies between results stays as it is.
    pub to: Place,
}

/// The largest number or a weighted sum of every channel in every patch: pools, and layers on each channel by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct FoldPatches {
    /// What becomes of a channel's numbers.
    pub fold: Fold,
    /// Of a sum: tiles of 16 channels, each with a row for every run of a patch.
    pub weights: u32,
    /// Of a sum: where each channel starts, whole tiles.
    pub bias: u32,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// The patches, whose runs are a number of every channel.
    pub patches: Patches,
    /// The picture.
    pub from: Place,
    /// The result, apart from it. What lies between results stays as it is.
    pub to: Place,
}

/// Whether patches and results lie inside their places; there are no more than the result has numbers.
pub(crate) fn fit(patches: &Patches, outputs: u32, [from, to]: [&Place; 2]) -> bool {
    let numbers = patches.total().saturating_mul(outputs.into());
    numbers > 0
        && patches.inputs() > 0
        && patches.reach() <= u64::from(from.len)
        && patches.result_reach(outputs) <= u64::from(to.len)
        && numbers <= u64::from(to.len)
}

/// Floats of weights that have a row for each of `rows`, and those of a bias.
fn lens(rows: u64, outputs: u32) -> [u64; 2] {
    let columns = u64::from(outputs).next_multiple_of(TILE);
    [rows.saturating_mul(columns), columns]
}

fn holds(sizes: &Sizes, [weights, bias]: [u32; 2], lens: [u64; 2]) -> bool {
    sizes.holds_weights(weights, lens[0]) && sizes.holds_weights(bias, lens[1])
}

fn parts(
    floats: &[f32],
    [weights, bias]: [u32; 2],
    lens: [u64; 2],
) -> Result<[&[f32]; 2], DecideError> {
    let [weights_len, bias_len] = lens.map(|len| usize::try_from(len).unwrap_or(usize::MAX));
    Ok([slice(floats, weights, weights_len)?, slice(floats, bias, bias_len)?])
}

impl Operator for ConvolvePatches {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        fit(&self.patches, self.outputs, [&self.from, &self.to])
            && holds(sizes, [self.weights, self.bias], lens(self.patches.inputs(), self.outputs))
            && sizes.hold_apart(&[&self.from, &self.to])
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        let [weights, _] = lens(self.patches.inputs(), self.outputs);
        weights.saturating_mul(self.patches.total())
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let lens = lens(self.patches.inputs(), self.outputs);
        let [weights, bias] = parts(weights, [self.weights, self.bias], lens)?;
        let [from, to] = places(scratch.floats, [&self.from, &self.to])?;
        let around = Around { bias: Some(bias), relu: self.relu.is_set() };
        let (patches, outputs) = (&self.patches, self.outputs as usize);
        kernels.convolve(&PatchLayer { patches, weights, around, outputs }, from, to);
        Ok(())
    }
}

impl Operator for FoldPatches {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        let (patches, channels) = (&self.patches, self.patches.run);
        let is_held = match self.fold {
            Fold::Sum => {
                holds(sizes, [self.weights, self.bias], lens(patches.total_runs(), channels))
            }
            // No more runs than the picture has numbers.
            Fold::Maximum => patches.total_runs() <= u64::from(self.from.len),
        };
        is_held
            && fit(patches, channels, [&self.from, &self.to])
            && sizes.hold_apart(&[&self.from, &self.to])
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        match self.fold {
            Fold::Sum => self.patches.inputs().saturating_mul(self.patches.total()),
            Fold::Maximum => 0,
        }
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (patches, outputs) = (&self.patches, self.patches.run as usize);
        let relu = self.relu.is_set();
        let (weights, bias) = match self.fold {
            Fold::Sum => {
                let lens = lens(patches.total_runs(), patches.run);
                let [weights, bias] = parts(weights, [self.weights, self.bias], lens)?;
                (weights, Some(bias))
            }
            Fold::Maximum => (&[] as &[f32], None),
        };
        let [from, to] = places(scratch.floats, [&self.from, &self.to])?;
        let layer = PatchLayer { patches, weights, around: Around { bias, relu }, outputs };
        kernels.fold(&layer, self.fold, from, to);
        Ok(())
    }
}
