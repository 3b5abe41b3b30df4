//! What an agent knows of the world: where each action led, and what was found there.

use serde::{Deserialize, Serialize};

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
