//! Networks over pictures, and what they are shown of one.

mod network;

use sortie_core::options::{self, LEVELS, PictureShape};
use sortie_envs::{Spec, View};
use sortie_nn::layers::SparseRows;

pub use network::Body;
#[cfg(test)]
pub(crate) use network::naive;
pub(crate) use network::{Heads, Network, NetworkShape, Space, best};

/// How a row of an observation, a picture and counts, becomes bytes that can be kept and columns of a network: as where
/// agents are deployed.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    shown: options::Shown,
    /// Whether networks are told how much is carried, as one number each; up to levels otherwise.
    counted: bool,
}

impl Shown {
    /// None of an environment that shows no picture, one that has too many channels, or no middle.
    pub(crate) fn new(spec: &Spec, crop: usize, nearest: bool, counted: bool) -> Option<Self> {
        let View::Pictures([channels, size, columns]) = spec.view else { return None };
        let counts = spec.shape.features.checked_sub(size * size * channels)?;
        let shape = PictureShape { channels, size, counts, crop, nearest };
        let shown = if size == columns { options::Shown::new(shape) } else { None };
        shown.map(|shown| Self { shown, counted })
    }

    pub(crate) fn shape(&self) -> PictureShape {
        *self.shown.shape()
    }

    /// Bytes of a state.
    pub(crate) fn bytes(&self) -> usize {
        self.shown.bytes()
    }

    pub(crate) fn columns(&self) -> usize {
        let columns = self.shown.columns();
        if self.counted { columns - (LEVELS.len() - 1) * self.shape().counts } else { columns }
    }

    /// Writes the bytes of the only row of an observation.
    pub(crate) fn write(&self, rows: &SparseRows, bytes: &mut [u8]) {
        self.shown.write(rows.row(0), bytes);
        if self.counted {
            let first = bytes.len() - self.shape().counts;
            bytes[first..].fill(0);
            let cells = self.shape().features() - self.shape().counts;
            for (column, count) in rows.row(0).filter(|(column, _)| *column >= cells) {
                bytes[first + column - cells] = count as u8;
            }
        }
    }

    /// Adds the row of the networks for the bytes of a state, in a mirror left for right.
    pub(crate) fn push(&self, bytes: &[u8], is_mirrored: bool, rows: &mut SparseRows) {
        let counts = if self.counted { self.shape().counts } else { 0 };
        let (lit, counts) = bytes.split_at(bytes.len() - counts);
        self.shown.light(lit, is_mirrored, |column| rows.push(column, 1.0));
        let items = counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let first = self.columns() - counts.len();
        items.for_each(|(item, count)| rows.push(first + item, f32::from(*count)));
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
                let shown = Shown::new(world.spec(), 5, nearest, false).unwrap();
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
        let shown = Shown::new(world.spec(), 3, true, false).unwrap();
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
        // Or as a number.
        let shown = Shown::new(world.spec(), 11, false, true).unwrap();
        let (mut bytes, mut rows) = (vec![7; shown.bytes()], SparseRows::default());
        shown.write(&seen, &mut bytes);
        shown.push(&bytes, false, &mut rows);
        let entries: Vec<_> = rows.row(0).collect();
        let carried = (121 * 9, 3.0);
        assert_eq!(entries, [((3 * 11 + 5) * 9 + 2, 1.0), ((5 * 11 + 3) * 9 + 2, 1.0), carried]);
        assert_eq!(shown.columns(), 121 * 9 + shown.shape().counts);
    }
}
