//! Which frozen policy is deployed: the one of several that returned most when it was played as it is.

use serde::{Deserialize, Serialize};

/// Policies that are tried out one after the other while others go on learning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Audition {
    /// Number of the policy that is tried out, from 1; 0 before the first.
    number: u32,
    episodes: u32,
    returns: f64,
    best: Option<f64>,
}

impl Audition {
    /// The policy that is tried out, by its number; 0 where none is.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// The mean return of the best so far.
    pub fn best(&self) -> Option<f64> {
        self.best
    }

    /// An episode of the policy of a number ended. Those of earlier ones do not count.
    pub fn add(&mut self, number: u32, episode_return: f64) {
        if number == self.number && number > 0 {
            self.episodes += 1;
            self.returns += episode_return;
        }
    }

    /// Whether the next policy is to be tried out, after so many episodes of one.
    pub fn is_over(&self, episodes: u32) -> bool {
        self.number == 0 || self.episodes >= episodes
    }

    /// Goes on to the next policy; returns whether the one before is the best so far.
    pub fn go_on(&mut self) -> bool {
        let mean = self.returns / f64::from(self.episodes);
        let is_best = self.episodes > 0 && self.best.is_none_or(|best| mean > best);
        if is_best {
            self.best = Some(mean);
        }
        *self = Self { number: self.number + 1, episodes: 0, returns: 0.0, best: self.best };
        is_best
    }
}
