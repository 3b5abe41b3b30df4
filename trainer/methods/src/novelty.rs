//! How novel it is to be where agents are, what that is worth (dissertation section 4.3), and what observations say of where
//! they are: what both learners of MA-Exp explore by.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_envs::{SparseRows, Spec};
use sortie_learn::words;

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

    /// Adds a state, from the rows of all agents.
    pub(crate) fn write_state(&self, rows: &SparseRows, state: &mut Vec<f32>) {
        let start = state.len();
        state.resize(start + rows.len() * self.of_state(), 0.0);
        let (seen, cells) = state[start..].split_at_mut(rows.len() * self.row);
        let places = seen.chunks_exact_mut(self.row).zip(cells.chunks_exact_mut(2 * SIDE));
        for (agent, (seen, cell)) in places.enumerate() {
            let before = rows.row(agent).filter(|(column, _)| *column < self.row);
            before.for_each(|(column, value)| seen[column] = value);
            let Place { cell: place, .. } = self.place(rows, agent);
            cell[usize::from(place) / SIDE] = 1.0;
            cell[SIDE + usize::from(place) % SIDE] = 1.0;
        }
    }

    pub(crate) fn cells<'a>(
        &'a self,
        rows: &'a SparseRows,
    ) -> impl Iterator<Item = u16> + Clone + 'a {
        (0..rows.len()).map(|agent| self.place(rows, agent).cell)
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

/// How fast novelty fades with visits.
const DECAY: f32 = 0.7;

/// How novel a place is that was visited so often.
pub fn novelty(visits: u32) -> f32 {
    (visits.max(1) as f32).powf(-DECAY)
}

/// Visits of each agent to each cell, over all instances and the whole run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    agents: usize,
    /// `[cells, agents]`
    visits: Vec<u32>,
    /// `[cells, agents]`: how novel each cell is to each agent.
    novelty: Vec<f32>,
    /// Visits of the whole team to its cells, where they are counted.
    joint: Option<BTreeMap<u64, u32>>,
}

impl Counts {
    /// Nobody has been anywhere; `joint` says whether teams are counted too.
    pub fn new(agents: usize, cells: usize, joint: bool) -> Self {
        let size = agents * cells;
        let joint = joint.then(BTreeMap::new);
        Self { agents, visits: vec![0; size], novelty: vec![1.0; size], joint }
    }

    /// The agents stand in these cells.
    pub fn visit(&mut self, cells: impl Iterator<Item = u16> + Clone) {
        for (agent, cell) in cells.clone().enumerate() {
            let place = usize::from(cell) * self.agents + agent;
            self.visits[place] = self.visits[place].saturating_add(1);
            self.novelty[place] = novelty(self.visits[place]);
        }
        if let Some(joint) = &mut self.joint {
            let visits = joint.entry(team(cells)).or_default();
            *visits = visits.saturating_add(1);
        }
    }

    /// `[agents, cells]`: visits of each agent to each cell.
    pub fn all(&self) -> Vec<Vec<u32>> {
        let of = |agent| self.visits.iter().skip(agent).step_by(self.agents).copied().collect();
        (0..self.agents).map(of).collect()
    }

    /// `[agents]`: how novel a cell is to each agent.
    #[inline]
    pub fn novelties(&self, cell: u16) -> &[f32] {
        &self.novelty[usize::from(cell) * self.agents..][..self.agents]
    }

    /// How novel it is that the team stands in these cells; 0 where teams are not counted.
    pub fn team_novelty(&self, cells: impl Iterator<Item = u16>) -> f32 {
        let visits = |joint: &BTreeMap<u64, u32>| joint.get(&team(cells)).copied().unwrap_or(0);
        self.joint.as_ref().map_or(0.0, |joint| novelty(visits(joint)))
    }
}

/// The cells of a team as one number.
fn team(cells: impl Iterator<Item = u16>) -> u64 {
    cells.fold(0, |key, cell| key << 16 | u64::from(cell))
}

words! {
    /// What counts as worth exploring.
    Intrinsic {
        /// What is novel to the agent itself.
        Independent = "independent",
        /// What is novel to everybody.
        Minimum = "minimum",
        /// What is more novel to the agent than to the team: places that it knows less than others.
        Covering = "covering",
        /// What is less novel to the agent than to the team: places that it knows better than others.
        Burrowing = "burrowing",
        /// The first agent burrows, the others cover.
        LeaderFollower = "leader-follower",
        /// Where the team as a whole has not been.
        Centralized = "centralized",
    }
}

impl Intrinsic {
    /// The types that the dissertation chooses among, in its order.
    pub const CHOSEN: [Self; 5] =
        [Self::Independent, Self::Minimum, Self::Covering, Self::Burrowing, Self::LeaderFollower];

    /// Its name, as configurations have it.
    pub fn name(self) -> &'static str {
        Self::WORDS[self as usize]
    }

    /// What an agent earns in a cell that is so novel to each agent, and where the team's cells together are so novel.
    ///
    /// In 32 bits and in the published order: where all are equal, the mean may differ from them by one bit, and a tie
    /// pays.
    #[inline]
    pub fn reward(self, novelties: &[f32], team: f32, agent: usize) -> f32 {
        let own = novelties[agent];
        let mean = || novelties.iter().sum::<f32>() / novelties.len() as f32;
        let paid = |pays: fn(&f32) -> bool| {
            let (mean, beyond) = (mean(), own - mean());
            if pays(&beyond) { beyond + mean } else { 0.0 }
        };
        match self {
            Self::Independent => own,
            Self::Minimum => novelties.iter().copied().fold(f32::INFINITY, f32::min),
            Self::Covering => paid(|beyond| *beyond > 0.0),
            Self::Burrowing => paid(|beyond| *beyond < 0.0),
            Self::LeaderFollower if agent == 0 => Self::Burrowing.reward(novelties, team, agent),
            Self::LeaderFollower => Self::Covering.reward(novelties, team, agent),
            Self::Centralized => team,
        }
    }
}

/// Types of intrinsic rewards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Types {
    /// The five that the dissertation chooses among.
    Multi,
    /// None.
    None,
    /// One.
    #[serde(untagged)]
    One(Intrinsic),
}

impl Types {
    /// All of them, as files have them.
    pub(crate) const WORDS: &[&str] = &[
        "multi",
        "none",
        "independent",
        "minimum",
        "covering",
        "burrowing",
        "leader-follower",
        "centralized",
    ];

    /// The types of the heads, and at last the one without.
    pub(crate) fn heads(self) -> Vec<Option<Intrinsic>> {
        let types = match self {
            Self::Multi => Intrinsic::CHOSEN.to_vec(),
            Self::None => Vec::new(),
            Self::One(intrinsic) => vec![intrinsic],
        };
        types.into_iter().map(Some).chain([None]).collect()
    }
}

/// How likely heads are, by softmax of their scores in this temperature: shares that add up to anything.
pub(crate) fn shares(scores: impl Iterator<Item = f64> + Clone, temperature: f64) -> Vec<f64> {
    let most = scores.clone().fold(f64::NEG_INFINITY, f64::max);
    scores.map(|score| ((score - most) / temperature).exp()).collect()
}

/// The discounted return of a running episode.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Discounted {
    pub(crate) sum: f64,
    /// What a reward of the next step counts.
    pub(crate) factor: f64,
}

impl Default for Discounted {
    fn default() -> Self {
        Self { sum: 0.0, factor: 1.0 }
    }
}

impl Discounted {
    /// Adds a reward.
    pub(crate) fn add(&mut self, reward: f64, discount: f32) {
        self.sum += self.factor * reward;
        self.factor *= f64::from(discount);
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
        let mut rows = SparseRows::default();
        [seen, other].iter().for_each(|row| rows.push_dense(row));
        assert_eq!(columns.cells(&rows).collect::<Vec<_>>(), [7 * 20 + 17, 19]);
        let mut state = Vec::new();
        columns.write_state(&rows, &mut state);
        assert_eq!(state.len(), 2 * columns.of_state());
        let ones: Vec<usize> = (8..state.len()).filter(|at| state[*at] == 1.0).collect();
        assert_eq!(state[..8], [1.0, 0.0, 0.0, 1.0, 0.0, 0.25, 1.0, 0.0]);
        assert_eq!(ones, [8 + 7, 8 + 20 + 17, 8 + 40, 8 + 60 + 19]);
        assert_eq!(state[8..].iter().sum::<f32>(), 4.0);
    }
}
