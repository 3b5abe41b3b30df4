//! What an agent knows of the world, and its values: those of all heads side by side, row by row as places are met.

use serde::{Deserialize, Serialize};

use crate::novelty::Place;

/// Where an action led.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Way {
    /// The row, or none where the episode ended.
    pub row: Option<u32>,
    /// How likely.
    pub chance: f32,
}

/// What came of an action in one place: running means that remember so many times.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// How often it was tried.
    pub tries: u32,
    /// How likely the agent finds something.
    pub find: f32,
    /// Where it led.
    pub ways: Vec<Way>,
}

impl Outcome {
    /// Adds a try. Partners change, so that no more than the last `memory` tries count, the older the less.
    #[inline]
    pub fn add(&mut self, row: Option<u32>, has_found: bool, memory: f32) {
        self.tries = self.tries.saturating_add(1);
        let rate = 1.0 / (self.tries as f32).min(memory);
        self.find += rate * (f32::from(u8::from(has_found)) - self.find);
        let mut is_known = false;
        for way in &mut self.ways {
            let is_this = way.row == row;
            way.chance += rate * (f32::from(u8::from(is_this)) - way.chance);
            is_known |= is_this;
        }
        if !is_known {
            self.ways.push(Way { row, chance: rate });
        }
    }
}

/// Actions that tables hold.
pub(super) const ACTIONS: usize = 5;
/// Heads that tables hold.
pub(super) const HEADS: usize = 8;

/// One number for each head.
pub type Lanes = [f32; HEADS];

/// What a place or an action is worth to each head.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Worth {
    /// In rewards of the team.
    pub extrinsic: Lanes,
    /// In exploring.
    pub intrinsic: Lanes,
}

/// What values are made by.
#[derive(Clone, Copy, Debug)]
pub struct Terms {
    /// By heads: what intrinsic values count in the choice of actions.
    pub weights: Lanes,
    /// Discounts of extrinsic and intrinsic rewards.
    pub discounts: [f32; 2],
    /// What a find earns, and what a step costs.
    pub shares: [f32; 2],
}

/// A place that was met.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The place.
    pub place: Place,
    /// What each action is worth.
    pub actions: [Worth; ACTIONS],
    /// What being here is worth, what is paid for coming here included.
    pub here: Worth,
    /// How novel the places of the whole team were when the agent was here last.
    pub team_novelty: f32,
    /// What came of each action.
    pub outcomes: [Outcome; ACTIONS],
    /// What each action was worth to the team when the policy was frozen that is tried out, and the best so far.
    frozen: [Option<[f32; ACTIONS]>; 2],
}

/// What an agent acts by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// What it knows now.
    Now,
    /// The frozen policy that is tried out.
    Tried,
    /// The best of those that were.
    Best,
}

impl Row {
    /// What an action is worth to a head that chooses.
    #[inline]
    pub fn score(&self, action: usize, head: usize, weights: &Lanes) -> f32 {
        let worth = &self.actions[action];
        worth.extrinsic[head] + weights[head] * worth.intrinsic[head]
    }

    /// What each action is worth to the team, as a head knows it, in some version; none of places that it does not know.
    pub fn utilities(&self, head: usize, version: Version) -> Option<[f32; ACTIONS]> {
        match version {
            Version::Now => Some(self.actions.map(|worth| worth.extrinsic[head])),
            Version::Tried => self.frozen[0],
            Version::Best => self.frozen[1],
        }
    }

    /// Freezes what a head knows now, to be tried out.
    pub fn freeze(&mut self, head: usize) {
        self.frozen[0] = self.utilities(head, Version::Now);
    }

    /// What is tried out is the best so far.
    pub fn keep(&mut self) {
        self.frozen[1] = self.frozen[0];
    }

    /// The worth of the action that each head likes best, the first of equal ones.
    fn best(&self, weights: &Lanes) -> Worth {
        let (mut best, mut scores) = (self.actions[0], [f32::NEG_INFINITY; HEADS]);
        for worth in &self.actions {
            for head in 0..HEADS {
                let score = worth.extrinsic[head] + weights[head] * worth.intrinsic[head];
                if score > scores[head] {
                    scores[head] = score;
                    best.extrinsic[head] = worth.extrinsic[head];
                    best.intrinsic[head] = worth.intrinsic[head];
                }
            }
        }
        best
    }
}

/// The values of an agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// What actions are worth that were never tried.
    start: Worth,
    /// By numbers of places: one more than the row, 0 where there is none.
    numbers: Vec<u32>,
    /// In the order in which they were met.
    pub rows: Vec<Row>,
}

impl Table {
    /// Without a row; `treasures` says how many places there can be.
    pub fn new(treasures: usize, start: Worth) -> Self {
        Self { start, numbers: vec![0; Place::count(treasures)], rows: Vec::new() }
    }

    /// The row of a place, which it gets if it has none.
    #[inline]
    pub fn row_of(&mut self, place: Place) -> u32 {
        let number = &mut self.numbers[place.index()];
        if *number == 0 {
            let actions = [self.start; ACTIONS];
            let outcomes = Default::default();
            self.rows.push(Row {
                place,
                actions,
                here: self.start,
                team_novelty: 1.0,
                outcomes,
                frozen: [None; 2],
            });
            *number = self.rows.len() as u32;
        }
        *number - 1
    }

    /// The row of a place that was met.
    pub fn find(&self, place: Place) -> Option<&Row> {
        let number = self.numbers.get(place.index()).copied().unwrap_or(0) as usize;
        self.rows.get(number.wrapping_sub(1))
    }

    /// Makes a row's values those that follow from what is known, given what each head pays for coming here.
    #[inline]
    pub fn back_up(&mut self, row: usize, terms: &Terms, paid: &Lanes) {
        let [find, cost] = terms.shares;
        let [discount, intrinsic_discount] = terms.discounts;
        for action in 0..ACTIONS {
            let outcome = &self.rows[row].outcomes[action];
            if outcome.tries == 0 {
                continue;
            }
            let mut worth = Worth { extrinsic: [0.0; HEADS], intrinsic: [0.0; HEADS] };
            for way in &outcome.ways {
                let Some(next) = way.row else { continue };
                let there = &self.rows[next as usize].here;
                for head in 0..HEADS {
                    worth.extrinsic[head] += way.chance * there.extrinsic[head];
                    worth.intrinsic[head] += way.chance * there.intrinsic[head];
                }
            }
            let earned = cost + find * outcome.find;
            worth.extrinsic = worth.extrinsic.map(|value| earned + discount * value);
            self.rows[row].actions[action] = worth;
        }
        let best = self.rows[row].best(&terms.weights);
        let here = &mut self.rows[row].here;
        here.extrinsic = best.extrinsic;
        for (head, paid) in paid.iter().enumerate() {
            here.intrinsic[head] = paid + intrinsic_discount * best.intrinsic[head];
        }
    }
}
