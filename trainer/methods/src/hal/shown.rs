//! What the networks are shown of a state: cells around the middle, the nearest of every channel, what is carried.

use sortie_envs::{Spec, View};
use sortie_nn::layers::SparseRows;

/// Numbers from which on a count lights the next column.
const LEVELS: [u16; 6] = [1, 2, 3, 4, 6, 8];

/// How a row of an observation, a picture and counts, becomes bytes that can be kept and columns of a network.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    channels: usize,
    size: usize,
    counts: usize,
    crop: usize,
    nearest: bool,
    /// Cells of the picture, nearest to the middle first.
    by_distance: Vec<usize>,
    /// The place of each cell among them.
    rank: Vec<u8>,
}

impl Shown {
    /// None of an environment that shows no picture, one that has too many channels, or no middle.
    pub(super) fn new(spec: &Spec, crop: usize, nearest: bool) -> Option<Self> {
        let View::Pictures([channels, size, columns]) = spec.view else { return None };
        let fits = size == columns && size % 2 == 1 && channels <= 16 && size <= 15;
        let fits = fits && crop <= size && crop % 2 == 1;
        let counts = spec.shape.features.checked_sub(size * size * channels).filter(|_| fits)?;
        let mut by_distance: Vec<usize> = (0..size * size).collect();
        by_distance.sort_by_key(|cell| {
            let ahead = (size / 2) as i32 - (cell / size) as i32;
            let across = (cell % size) as i32 - (size / 2) as i32;
            // Of equals what lies straight ahead, then ahead, then beside, then behind.
            let side = if ahead > 0 { i32::from(across != 0) } else { 2 + i32::from(ahead < 0) };
            (ahead.abs() + across.abs(), side, *cell)
        });
        let mut rank = vec![0; size * size];
        by_distance.iter().enumerate().for_each(|(place, cell)| rank[*cell] = place as u8);
        Some(Self { channels, size, counts, crop, nearest, by_distance, rank })
    }

    /// Bytes of a state.
    pub(super) fn bytes(&self) -> usize {
        2 * self.crop * self.crop + self.nearest_channels() + self.counts
    }

    /// Columns of the networks.
    pub(super) fn columns(&self) -> usize {
        self.crop * self.crop * self.channels
            + self.nearest_channels() * self.size * self.size
            + self.counts * LEVELS.len()
    }

    fn nearest_channels(&self) -> usize {
        if self.nearest { self.channels } else { 0 }
    }

    /// Writes the bytes of the only row of an observation.
    pub(super) fn write(&self, rows: &SparseRows, bytes: &mut [u8]) {
        let cells = self.size * self.size;
        let border = (self.size - self.crop) / 2;
        let inside = border..border + self.crop;
        let (crop, rest) = bytes.split_at_mut(2 * self.crop * self.crop);
        let (nearest, counts) = rest.split_at_mut(self.nearest_channels());
        crop.fill(0);
        nearest.fill(u8::MAX);
        counts.fill(0);
        for (column, value) in rows.row(0) {
            let (cell, channel) = (column / self.channels, column % self.channels);
            if cell >= cells {
                let count = value as u16;
                counts[column - cells * self.channels] =
                    LEVELS.iter().filter(|level| count >= **level).count() as u8;
                continue;
            }
            if self.nearest {
                nearest[channel] = nearest[channel].min(self.rank[cell]);
            }
            let (y, x) = (cell / self.size, cell % self.size);
            if inside.contains(&y) && inside.contains(&x) {
                let place = (y - border) * self.crop + x - border;
                crop[2 * place + channel / 8] |= 1 << (channel % 8);
            }
        }
    }

    /// Adds the row of the networks for the bytes of a state, in a mirror left for right.
    pub(super) fn push(&self, bytes: &[u8], is_mirrored: bool, rows: &mut SparseRows) {
        let (crop, rest) = bytes.split_at(2 * self.crop * self.crop);
        let (nearest, counts) = rest.split_at(self.nearest_channels());
        let mirrored = |cell: usize, size: usize| {
            if is_mirrored { cell / size * size + size - 1 - cell % size } else { cell }
        };
        for (cell, bits) in crop.chunks_exact(2).enumerate() {
            let mut bits = u16::from_le_bytes([bits[0], bits[1]]);
            let first = mirrored(cell, self.crop) * self.channels;
            while bits != 0 {
                rows.push(first + bits.trailing_zeros() as usize, 1.0);
                bits &= bits - 1;
            }
        }
        let first = self.crop * self.crop * self.channels;
        let cells = self.size * self.size;
        for (channel, rank) in nearest.iter().enumerate() {
            if let Some(cell) = self.by_distance.get(usize::from(*rank)) {
                rows.push(first + channel * cells + mirrored(*cell, self.size), 1.0);
            }
        }
        let first = first + nearest.len() * cells;
        for (item, level) in counts.iter().enumerate() {
            (0..usize::from(*level))
                .for_each(|level| rows.push(first + item * LEVELS.len() + level, 1.0));
        }
        rows.end_row();
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{EntitySet, Observation, Split};

    use super::*;

    #[test]
    fn a_state_seen_in_a_mirror_is_shown_as_its_bytes_are_mirrored() {
        for name in ["crafting/iron", "treasure-rooms"] {
            let mut world = sortie_envs::open(name, Split::Train, 1, &Default::default()).unwrap();
            for nearest in [false, true] {
                let shown = Shown::new(world.spec(), 5, nearest).unwrap();
                let (mut differing, mut lopsided) = (0, 0);
                for seed in 0..50 {
                    world.reset(0, &mut sortie_envs::random::generator(seed));
                    let mut state = Vec::new();
                    world.save(0, &mut state);
                    let columns = |turn: usize, is_mirrored: bool| {
                        let mut seen = Observation::default();
                        world.observe(&state, turn, EntitySet::MAX, &mut seen);
                        let (mut bytes, mut rows) = (vec![9; shown.bytes()], SparseRows::default());
                        shown.write(&seen.rows, &mut bytes);
                        shown.push(&bytes, is_mirrored, &mut rows);
                        let mut columns: Vec<_> = rows.row(0).map(|entry| entry.0).collect();
                        assert!(columns.iter().all(|column| *column < shown.columns()));
                        columns.sort_unstable();
                        columns
                    };
                    differing += usize::from(columns(0, true) != columns(1, false));
                    lopsided += usize::from(columns(0, false) != columns(1, false));
                }
                assert!(lopsided > 25, "{name} {lopsided}");
                // Of two that are as near on either side the same one is taken.
                assert!(
                    if nearest { differing < 50 } else { differing == 0 },
                    "{name} {differing}"
                );
            }
        }
    }

    #[test]
    fn the_nearest_and_what_is_carried_light_their_columns() {
        let world =
            sortie_envs::open("crafting/iron", Split::Train, 1, &Default::default()).unwrap();
        let shown = Shown::new(world.spec(), 3, true).unwrap();
        let mut seen = SparseRows::default();
        // A tree two cells ahead, another beside; three logs.
        for cell in [3 * 11 + 5, 5 * 11 + 3] {
            seen.push(cell * 9 + 2, 1.0);
        }
        seen.push(121 * 9, 3.0);
        seen.end_row();
        let (mut bytes, mut rows) = (vec![0; shown.bytes()], SparseRows::default());
        shown.write(&seen, &mut bytes);
        shown.push(&bytes, false, &mut rows);
        let columns: Vec<_> = rows.row(0).map(|entry| entry.0).collect();
        let items = 81 + 9 * 121;
        assert_eq!(columns, [81 + 2 * 121 + 3 * 11 + 5, items, items + 1, items + 2]);
    }
}
