//! Convolutions of a picture.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Flag, LAYOUT_TILES, Linear, Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// A layer on every patch of a picture. Pictures stand channel behind channel, each row behind row.
///
/// A patch of C channels, K x L points is the layer's input, channel behind channel; points outside of the picture are 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Convolve {
    /// The layer, from C K L inputs to the channels of the result.
    pub layer: Linear,
    /// Whether a ReLU follows.
    pub relu: Flag,
    /// Channels C of the picture.
    pub channels: u32,
    /// Height and width of the picture.
    pub size: [u32; 2],
    /// Height K and width L of a patch.
    pub kernel: [u32; 2],
    /// From one patch to the next, down and to the right.
    pub stride: [u32; 2],
    /// From one point of a patch to the next.
    pub dilation: [u32; 2],
    /// Points outside of the picture, above it and on its left.
    pub padding: [u32; 2],
    /// Height and width of the result.
    pub result: [u32; 2],
    /// The picture.
    pub from: Place,
    /// Room for a patch.
    pub patch: Place,
    /// Room for what the layer makes of it, as long as the layer's padded outputs.
    pub point: Place,
    /// The result.
    pub to: Place,
}

impl Convolve {
    /// Along one of both directions: where in the picture a point of a patch lies; none where outside.
    #[inline(always)]
    fn at(&self, direction: usize, patch: usize, point: usize) -> Option<usize> {
        let of = |numbers: &[u32; 2]| numbers.get(direction).copied().unwrap_or_default() as usize;
        let place = patch.checked_mul(of(&self.stride))?;
        let place = place.checked_add(point.checked_mul(of(&self.dilation))?)?;
        let place = place.checked_sub(of(&self.padding))?;
        (place < of(&self.size)).then_some(place)
    }

    /// Brings a patch together.
    #[inline(always)]
    fn gather(&self, from: &[f32], [row, column]: [usize; 2], patch: &mut [f32]) {
        let [height, width] = self.size.map(|size| size as usize);
        let [rows, columns] = self.kernel.map(|size| size as usize);
        let channels = from.chunks_exact((height * width).max(1));
        for (channel, patch) in channels.zip(patch.chunks_exact_mut((rows * columns).max(1))) {
            for (k, patch) in patch.chunks_exact_mut(columns.max(1)).enumerate() {
                let from = self.at(0, row, k).and_then(|y| channel.get(y * width..));
                for (l, point) in patch.iter_mut().enumerate() {
                    let number = from.and_then(|from| from.get(self.at(1, column, l)?));
                    *point = number.copied().unwrap_or_default();
                }
            }
        }
    }
}

impl Operator for Convolve {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let area = |[height, width]: [u32; 2]| u64::from(height) * u64::from(width);
        let times = |channels: u32, area: u64| u64::from(channels).checked_mul(area);
        let lengths = times(self.channels, area(self.size)) == Some(self.from.len.into())
            && times(self.channels, area(self.kernel)) == Some(self.layer.inputs.into())
            && times(self.layer.outputs.into(), area(self.result)) == Some(self.to.len.into())
            && self.patch.len == u32::from(self.layer.inputs)
            && self.point.len as usize == self.layer.padded_outputs();
        let moves = self.stride.iter().chain(&self.dilation).all(|step| *step > 0);
        self.layer.check(sizes)
            && self.from.len > 0
            && self.to.len > 0
            && lengths
            && moves
            && sizes.hold_apart(&[&self.from, &self.patch, &self.point, &self.to])
    }

    fn reads(&self) -> Places {
        Places::of([self.from])
    }

    fn writes(&self) -> Places {
        // The rooms are nobody else's to read.
        Places::of([self.to])
    }

    fn multiply_adds(&self, _: u64) -> u64 {
        let [height, width] = self.result.map(u64::from);
        self.layer.multiply_adds().saturating_mul(height.saturating_mul(width))
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        weights: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let matrix = self.layer.matrix(weights)?;
        let around = self.layer.around(weights, self.relu.is_set())?;
        let wanted = [&self.from, &self.patch, &self.point, &self.to];
        let [from, patch, point, to] = places(scratch.floats, wanted)?;
        let [height, width] = self.result.map(|size| size as usize);
        for row in 0..height {
            for column in 0..width {
                self.gather(from, [row, column], patch);
                kernels.product(matrix, patch, around, point);
                let channels = to.chunks_exact_mut((height * width).max(1));
                for (channel, number) in channels.zip(&*point) {
                    if let Some(to) = channel.get_mut(row * width + column) {
                        *to = *number;
                    }
                }
            }
        }
        Ok(())
    }
}
