//! An agent's values: those of all heads side by side, row by row as places are met.

use serde::{Deserialize, Serialize};

use super::places::Place;

/// Actions that tables hold.
pub const ACTIONS: usize = 5;
/// Heads that tables hold.
pub const HEADS: usize = 8;

/// One number for each head.
pub type Lanes = [f32; HEADS];

/// The values of all actions in one place, by actions and heads.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Values {
    /// What is earned from the team.
    pub extrinsic: [Lanes; ACTIONS],
    /// What is earned by exploring.
    pub intrinsic: [Lanes; ACTIONS],
}

/// The best action of each head in one place, and its values.
#[derive(Clone, Copy, Debug)]
pub struct Best {
    /// The action.
    pub action: [u32; HEADS],
    /// Its value to the team.
    pub extrinsic: Lanes,
    /// Its value in exploring.
    pub intrinsic: Lanes,
}

impl Values {
    /// The best of some actions, by extrinsic values and so much of the intrinsic ones; the first of equal ones.
    #[inline]
    pub fn best(&self, weights: &Lanes, actions: u8) -> Best {
        let mut best = Best {
            action: [0; HEADS],
            extrinsic: self.extrinsic[0],
            intrinsic: self.intrinsic[0],
        };
        let mut sums = [f32::NEG_INFINITY; HEADS];
        for action in (0..ACTIONS).filter(|action| actions >> action & 1 == 1) {
            let (extrinsic, intrinsic) = (&self.extrinsic[action], &self.intrinsic[action]);
            for head in 0..HEADS {
                let sum = extrinsic[head] + weights[head] * intrinsic[head];
                let is_better = sum > sums[head];
                sums[head] = if is_better { sum } else { sums[head] };
                best.action[head] = if is_better { action as u32 } else { best.action[head] };
                best.extrinsic[head] =
                    if is_better { extrinsic[head] } else { best.extrinsic[head] };
                best.intrinsic[head] =
                    if is_better { intrinsic[head] } else { best.intrinsic[head] };
            }
        }
        best
    }
}

/// The values of an agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    start: Values,
    /// By numbers of places: one more than the row, 0 where there is none.
    rows: Vec<u32>,
    /// By rows: their places.
    pub places: Vec<Place>,
    /// By rows.
    pub values: Vec<Values>,
}

/// All actions, as bits.
pub const ALL: u8 = (1 << ACTIONS) - 1;

impl Table {
    /// Without a row; `treasures` says how many places there can be.
    pub fn new(treasures: usize, start: Values) -> Self {
        Self { start, rows: vec![0; Place::count(treasures)], places: vec![], values: vec![] }
    }

    /// The row of a place, which it gets if it has none.
    #[inline]
    pub fn row_of(&mut self, place: Place) -> u32 {
        let row = &mut self.rows[place.index()];
        if *row == 0 {
            self.places.push(place);
            self.values.push(self.start);
            *row = self.places.len() as u32;
        }
        *row - 1
    }

    /// The row of a place that was met.
    #[inline]
    pub fn find(&self, place: Place) -> Option<usize> {
        (self.rows[place.index()] as usize).checked_sub(1)
    }
}
