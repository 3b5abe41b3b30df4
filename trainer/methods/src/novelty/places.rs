//! What an agent's tables are asked by: its cell, the pit that it sees, and what it found.

use serde::{Deserialize, Serialize};
use sortie_envs::{SparseRows, Spec};

/// Probabilities of a pit from which on it counts as likelier to open; below the first it counts as none.
pub(crate) const PITS: [f32; 3] = [0.02, 0.08, 0.25];
/// Rows and columns of the maps that tables are about: agents see where they are as shares of them.
pub(crate) const SIDE: usize = 20;
/// Cells of such a map.
pub(crate) const CELLS: usize = SIDE * SIDE;
/// Kinds of pits.
const KINDS: usize = PITS.len() + 1;

/// Which columns of an observation say what.
#[derive(Clone, Debug, PartialEq)]
pub struct Columns {
    pits: std::ops::Range<usize>,
    found: std::ops::Range<usize>,
    row: usize,
    column: usize,
    /// All of them.
    width: usize,
}

impl Columns {
    /// The columns by their names; none where an environment shows no such things.
    pub fn of(spec: &Spec) -> Option<Self> {
        let at = |name: &str| spec.features.iter().position(|feature| feature == name);
        let block = |prefix: &str| {
            let first = spec.features.iter().position(|feature| feature.starts_with(prefix))?;
            let named = |feature: &&String| feature.starts_with(prefix);
            Some(first..first + spec.features[first..].iter().take_while(named).count())
        };
        let found = block("found-")?;
        let fits = found.len() <= 8;
        fits.then_some(())?;
        let (row, column, width) = (at("row")?, at("column")?, spec.features.len());
        Some(Self { pits: block("pit-")?, found, row, column, width })
    }

    /// Kinds of treasures.
    pub fn treasures(&self) -> usize {
        self.found.len()
    }

    /// `[d]` each: what a row is multiplied with to give the cell, the probability of the pit that is seen, and the set
    /// of what was found as a number.
    pub fn weights(&self) -> [Vec<f32>; 3] {
        let columns = self.width;
        let mut weights = [vec![0.0; columns], vec![0.0; columns], vec![0.0; columns]];
        weights[0][self.row] = (SIDE * SIDE) as f32;
        weights[0][self.column] = SIDE as f32;
        weights[1][self.pits.clone()].fill(1.0);
        for (place, column) in self.found.clone().enumerate() {
            weights[2][column] = (1_u32 << place) as f32;
        }
        weights
    }

    /// Columns of a state for each agent: what it sees of walls, pits and finds, and its row and its column of the map.
    pub(crate) fn of_state(&self) -> usize {
        self.row + 2 * SIDE
    }

    /// Adds a state, from what all agents see, one behind the other.
    pub(crate) fn write_state(&self, observation: &[f32], state: &mut Vec<f32>) {
        for row in observation.chunks_exact(self.width) {
            state.extend_from_slice(&row[..self.row]);
        }
        for cell in self.cells(observation) {
            let start = state.len();
            state.resize(start + 2 * SIDE, 0.0);
            state[start + usize::from(cell) / SIDE] = 1.0;
            state[start + SIDE + usize::from(cell) % SIDE] = 1.0;
        }
    }

    /// The agents' cells, from the same.
    pub(crate) fn cells<'a>(
        &self,
        observation: &'a [f32],
    ) -> impl Iterator<Item = u16> + Clone + 'a {
        let (row, column) = (self.row, self.column);
        observation.chunks_exact(self.width).map(move |seen| {
            let [row, column] = [seen[row], seen[column]].map(|part| (part * SIDE as f32).round());
            row as u16 * SIDE as u16 + column as u16
        })
    }

    /// Where a row says that its agent is.
    #[inline]
    pub fn place(&self, rows: &SparseRows, row: usize) -> Place {
        let (mut place, mut cell) = (Place::default(), [0.0; 2]);
        for (column, value) in rows.row(row) {
            if self.pits.contains(&column) {
                place.pit = PITS.iter().filter(|least| value >= **least).count() as u8;
            } else if self.found.contains(&column) {
                place.found |= 1 << (column - self.found.start);
            } else if column == self.row {
                cell[0] = value;
            } else if column == self.column {
                cell[1] = value;
            }
        }
        let [row, column] = cell.map(|part| (part * SIDE as f32).round() as u16);
        place.cell = row * SIDE as u16 + column;
        place
    }
}

/// What an agent's tables are asked by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Place {
    /// Its cell.
    pub cell: u16,
    /// The pit that it sees, by how likely it opens.
    pub pit: u8,
    /// The treasures that it found, as bits.
    pub found: u8,
}

impl Place {
    /// How many there can be with so many treasures.
    pub fn count(treasures: usize) -> usize {
        (CELLS * KINDS) << treasures
    }

    /// Its number.
    #[inline]
    pub fn index(self) -> usize {
        let Self { cell, pit, found } = self;
        (usize::from(found) * KINDS + usize::from(pit)) * CELLS + usize::from(cell)
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::gridworld;

    use super::*;

    #[test]
    fn tables_are_about_the_cells_that_there_are() {
        assert_eq!((SIDE, CELLS), (gridworld::SIDE, gridworld::CELLS));
    }

    #[test]
    fn a_state_is_what_all_see_of_themselves_and_where_they_are() {
        // A wall, a pit and two kinds of finds, then row, column and where the other is.
        let columns = Columns { pits: 1..2, found: 2..4, row: 4, column: 5, width: 8 };
        let seen = [1.0, 0.0, 0.0, 1.0, 0.35, 0.85, 0.3, 0.3];
        let other = [0.0, 0.25, 1.0, 0.0, 0.0, 0.95, -0.3, -0.3];
        let observation = [seen, other].concat();
        assert_eq!(columns.cells(&observation).collect::<Vec<_>>(), [7 * 20 + 17, 19]);
        let mut state = Vec::new();
        columns.write_state(&observation, &mut state);
        assert_eq!(state.len(), 2 * columns.of_state());
        let ones: Vec<usize> = (8..state.len()).filter(|at| state[*at] == 1.0).collect();
        assert_eq!(state[..8], [1.0, 0.0, 0.0, 1.0, 0.0, 0.25, 1.0, 0.0]);
        assert_eq!(ones, [8 + 7, 8 + 20 + 17, 8 + 40, 8 + 60 + 19]);
        assert_eq!(state[8..].iter().sum::<f32>(), 4.0);
    }
}
