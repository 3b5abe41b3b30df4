//! What networks are shown of a picture: cells around the middle, the nearest of every channel, what is carried.

use crate::identity::fnv1a;

/// Numbers from which on a count lights the next column.
pub const LEVELS: [u16; 6] = [1, 2, 3, 4, 6, 8];

/// Most bytes of a [`Shown`] state.
const SHOWN_BYTES: usize = 512;

/// Most cells to a side.
const SIDE: usize = 15;
const CELLS: usize = SIDE * SIDE;
const CHANNELS: usize = 16;
const COUNTS: usize = 32;

const _: () = assert!(2 * CELLS + CHANNELS + COUNTS <= SHOWN_BYTES);

/// Sizes of a row: a picture, cell by cell its channels, and counts behind it; and what of it is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureShape {
    /// Channels of a cell, at most 16.
    pub channels: usize,
    /// Cells to each side, odd, at most 15.
    pub size: usize,
    /// Counts, at most 32.
    pub counts: usize,
    /// Cells around the middle, to each side, that are shown one by one; odd.
    pub crop: usize,
    /// Whether the nearest cell of every channel is shown.
    pub nearest: bool,
}

impl PictureShape {
    /// Numbers of a row.
    pub const fn features(&self) -> usize {
        self.size * self.size * self.channels + self.counts
    }
}

/// How a row becomes bytes that can be kept, and those become columns of a network, each 0 or 1.
#[derive(Clone, Debug)]
pub struct Shown {
    shape: PictureShape,
    /// Cells of the picture, nearest to the middle first.
    by_distance: [u8; CELLS],
    /// The place of each cell among them.
    rank: [u8; CELLS],
    /// The place of each cell among those that are shown one by one, [`OUTSIDE`] of others.
    around: [u8; CELLS],
}

/// What is behind every cell that is shown.
const OUTSIDE: u8 = CELLS as u8;

impl Shown {
    /// None of a picture that is too large, or has no such middle.
    pub fn new(shape: PictureShape) -> Option<Self> {
        let PictureShape { channels, size, counts, crop, .. } = shape;
        let fits = size % 2 == 1 && crop % 2 == 1 && crop <= size && size <= SIDE;
        if !fits || channels == 0 || channels > CHANNELS || counts > COUNTS {
            return None;
        }
        let (mut by_distance, mut rank) = ([0; CELLS], [0; CELLS]);
        let order = |cell: usize| order(cell, size);
        for (cell, place) in rank.iter_mut().enumerate().take(size * size) {
            let before = (0..size * size).filter(|other| order(*other) < order(cell)).count();
            *place = before as u8;
            *by_distance.get_mut(before)? = cell as u8;
        }
        let border = (size - crop) / 2;
        let inside = border..border + crop;
        let around = core::array::from_fn(|cell| {
            let (y, x) = (cell / size.max(1), cell % size.max(1));
            let is_shown = inside.contains(&y) && inside.contains(&x);
            if is_shown { ((y - border) * crop + x - border) as u8 } else { OUTSIDE }
        });
        Some(Self { shape, by_distance, rank, around })
    }

    /// The sizes.
    pub fn shape(&self) -> &PictureShape {
        &self.shape
    }

    /// Bytes of a state.
    pub fn bytes(&self) -> usize {
        let PictureShape { crop, counts, .. } = self.shape;
        2 * crop * crop + self.nearest_channels() + counts
    }

    /// Columns of the networks.
    pub fn columns(&self) -> usize {
        let PictureShape { channels, size, counts, crop, .. } = self.shape;
        crop * crop * channels + self.nearest_channels() * size * size + counts * LEVELS.len()
    }

    fn nearest_channels(&self) -> usize {
        if self.shape.nearest { self.shape.channels } else { 0 }
    }

    /// Lays a row out as the columns of the networks, [`Self::columns`] of them; what stands for it, as [`view_of`] says.
    pub fn lay_out(&self, row: &[f32], columns: &mut [f32]) -> Option<u32> {
        let mut bytes = [0; SHOWN_BYTES];
        let bytes = bytes.get_mut(..self.bytes())?;
        let entries = row.iter().copied().enumerate().filter(|entry| entry.1 != 0.0);
        self.write(entries, bytes);
        columns.fill(0.0);
        self.light(bytes, false, |column| {
            columns.get_mut(column).into_iter().for_each(|to| *to = 1.0);
        });
        Some(view_of(bytes))
    }

    /// Writes the bytes of a row, of which all numbers that are not zero are given with their columns.
    pub fn write(&self, entries: impl Iterator<Item = (usize, f32)>, bytes: &mut [u8]) {
        let PictureShape { channels, size, crop, .. } = self.shape;
        let (around, rest) = bytes.split_at_mut_checked(2 * crop * crop).unwrap_or_default();
        let (nearest, counts) =
            rest.split_at_mut_checked(self.nearest_channels()).unwrap_or_default();
        around.fill(0);
        nearest.fill(u8::MAX);
        counts.fill(0);
        for (column, value) in entries {
            let Some((cell, channel)) = cell_of(column, channels, size) else {
                if let Some(level) = counts.get_mut(column - size * size * channels) {
                    let count = value as u16;
                    *level = LEVELS.iter().filter(|least| count >= **least).count() as u8;
                }
                continue;
            };
            if let (Some(least), Some(rank)) = (nearest.get_mut(channel), self.rank.get(cell)) {
                *least = (*least).min(*rank);
            }
            let place = self.around.get(cell).copied().unwrap_or(OUTSIDE);
            // Behind the last one there is no byte for a cell outside.
            let byte = around.get_mut(2 * usize::from(place) + channel / 8);
            byte.into_iter().for_each(|bits| *bits |= 1 << (channel % 8));
        }
    }

    /// Names the columns that are 1 for the bytes of a state, in a mirror left for right, in rising order but for the
    /// mirror.
    pub fn light(&self, bytes: &[u8], is_mirrored: bool, mut column: impl FnMut(usize)) {
        let PictureShape { channels, size, crop, .. } = self.shape;
        let (around, rest) = bytes.split_at_checked(2 * crop * crop).unwrap_or_default();
        let (nearest, counts) = rest.split_at_checked(self.nearest_channels()).unwrap_or_default();
        let mirrored = |cell: usize, size: usize| {
            if is_mirrored { cell / size * size + size - 1 - cell % size } else { cell }
        };
        for (cell, bits) in around.as_chunks::<2>().0.iter().enumerate() {
            let mut bits = u16::from_le_bytes(*bits);
            let first = mirrored(cell, crop.max(1)) * channels;
            while bits != 0 {
                column(first + bits.trailing_zeros() as usize);
                bits &= bits - 1;
            }
        }
        let first = crop * crop * channels;
        for (channel, rank) in nearest.iter().enumerate() {
            if usize::from(*rank) < size * size
                && let Some(cell) = self.by_distance.get(usize::from(*rank))
            {
                column(first + channel * size * size + mirrored(usize::from(*cell), size.max(1)));
            }
        }
        let first = first + nearest.len() * size * size;
        for (item, level) in counts.iter().enumerate() {
            (0..usize::from(*level)).for_each(|level| column(first + item * LEVELS.len() + level));
        }
    }
}

/// The number that stands for the bytes of a state, among 2^24, which an f32 holds exactly.
pub fn view_of(bytes: &[u8]) -> u32 {
    (fnv1a(bytes) >> 40) as u32
}

/// The cell and channel of a column; none of a count.
fn cell_of(column: usize, channels: usize, size: usize) -> Option<(usize, usize)> {
    // Rows are short: a division of 32 bits is a fraction of one of 64.
    let (column, channels) = (column as u32, channels as u32);
    let (cell, channel) = (column.checked_div(channels)?, column.checked_rem(channels)?);
    let cell = cell as usize;
    (cell < size * size).then_some((cell, channel as usize))
}

/// Of equals in distance what lies straight ahead comes first, then ahead, then beside, then behind.
fn order(cell: usize, size: usize) -> (usize, usize, usize) {
    let (y, x) = (cell / size.max(1), cell % size.max(1));
    let middle = size / 2;
    let side = match () {
        () if y < middle => usize::from(x != middle),
        () => 2 + usize::from(y > middle),
    };
    (y.abs_diff(middle) + x.abs_diff(middle), side, cell)
}
