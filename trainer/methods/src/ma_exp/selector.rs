//! Which head acts in an episode.

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::{below, chance, unit};

/// How fast means of returns follow.
const RATE: f64 = 0.1;

/// Means of the discounted returns of episodes by the head that acted in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Selector {
    means: Vec<Option<f64>>,
}

impl Selector {
    /// So many heads, none of which was tried.
    pub fn new(heads: usize) -> Self {
        Self { means: vec![None; heads] }
    }

    /// What each head's episodes returned; none of heads that were never tried.
    pub fn means(&self) -> &[Option<f64>] {
        &self.means
    }

    /// An episode ended in which a head acted.
    pub fn add(&mut self, head: usize, discounted: f64) {
        let mean = &mut self.means[head];
        *mean = Some(mean.map_or(discounted, |mean| mean + RATE * (discounted - mean)));
    }

    /// A head that was never tried, else with such a chance any, else one that returns much, by softmax.
    pub fn choose(&self, any: f64, temperature: f64, random: &mut Random) -> usize {
        let untried = self.means.iter().position(Option::is_none);
        if let Some(head) = untried {
            return head;
        }
        if chance(random, any) {
            return below(random, self.means.len());
        }
        let means = || self.means.iter().flatten();
        let best = means().copied().fold(f64::NEG_INFINITY, f64::max);
        let shares: Vec<f64> = means().map(|mean| ((mean - best) / temperature).exp()).collect();
        let mut left = unit(random) * shares.iter().sum::<f64>();
        let drawn = shares.iter().position(|share| {
            left -= share;
            left < 0.0
        });
        drawn.unwrap_or(self.means.len() - 1)
    }
}
