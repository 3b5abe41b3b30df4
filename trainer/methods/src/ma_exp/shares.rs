//! How the team's reward is shared out among those who earn it.

use serde::{Deserialize, Serialize};

/// What of the team's reward an agent's find and its steps are worth: the least squares of all steps so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shares {
    steps: f64,
    finds: f64,
    squares: f64,
    rewards: f64,
    products: f64,
}

impl Shares {
    /// Adds a step in which so many agents found something.
    pub fn add(&mut self, finds: usize, reward: f64) {
        let finds = finds as f64;
        self.steps += 1.0;
        self.finds += finds;
        self.squares += finds * finds;
        self.rewards += reward;
        self.products += finds * reward;
    }

    /// What a find adds for whoever made it, and what is left for each of so many agents in every step.
    pub fn of(&self, agents: usize) -> [f32; 2] {
        let spread = self.steps * self.squares - self.finds * self.finds;
        let slope = self.steps * self.products - self.finds * self.rewards;
        let find = if spread > 0.0 { slope / spread } else { 0.0 };
        let rest = (self.rewards - find * self.finds) / self.steps.max(1.0);
        [find as f32, (rest / agents as f64) as f32]
    }
}
