//! Which head acts: a meta-policy over what turns return.

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::below;
use sortie_learn::random::by_weight;
use sortie_nn::random::normals;

use super::MetaConfig;
use crate::novelty::shares;

/// The meta-policy, and what the turns of each head returned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetaPolicy {
    /// By heads: its scores.
    pub scores: Vec<f64>,
    /// By heads: discounted returns of the team.
    pub returns: Vec<Moments>,
    /// The head that acts.
    pub head: usize,
    turns: u64,
}

impl MetaPolicy {
    /// One that hardly prefers any of so many heads.
    pub fn new(heads: usize, random: &mut Random) -> Self {
        let scores =
            normals(random, heads).into_iter().map(|score| 0.01 * f64::from(score)).collect();
        let mut meta = Self { scores, returns: vec![Moments::default(); heads], head: 0, turns: 0 };
        meta.draw(false, random);
        meta
    }

    /// By heads: the chance to be drawn.
    pub fn chances(&self) -> Vec<f64> {
        let shares = shares(self.scores.iter().copied(), 1.0);
        let sum: f64 = shares.iter().sum();
        shares.into_iter().map(|share| share / sum).collect()
    }

    /// Learns from the discounted returns of a turn of the head that acts.
    pub fn learn(&mut self, config: &MetaConfig, returns: &[f64]) {
        let mean = returns.iter().sum::<f64>() / returns.len() as f64;
        if self.turns == 0 {
            self.returns.iter_mut().for_each(|moments| moments.mean = mean);
        }
        self.turns += 1;
        self.returns[self.head].add(returns);
        for _ in 0..config.steps {
            let chances = self.chances();
            let expected = self.returns.iter().zip(&chances).map(|(of, chance)| of.mean * chance);
            let surprise = -chances[self.head].ln();
            let advantage = config.entropy * surprise + mean - expected.sum::<f64>();
            for (head, (score, chance)) in self.scores.iter_mut().zip(chances).enumerate() {
                let slope = f64::from(u8::from(head == self.head)) - chance;
                *score -= config.rate * (config.decay * *score - advantage * slope);
            }
        }
    }

    /// Draws the head of the next turn.
    pub fn draw(&mut self, uniform: bool, random: &mut Random) {
        let heads = self.scores.len();
        let drawn = by_weight(random, &self.chances());
        self.head = if uniform { below(random, heads) } else { drawn };
    }

    /// The head whose turns returned most, the first of equal ones: the one that is deployed.
    pub fn best(&self) -> usize {
        let mean = |head: &usize| self.returns[*head].mean;
        (0..self.returns.len()).rev().max_by(|a, b| mean(a).total_cmp(&mean(b))).unwrap_or(0)
    }
}

/// Mean and variance, and of how many numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// The mean.
    pub mean: f64,
    /// The variance.
    pub variance: f64,
    /// The numbers; a first guess counts little.
    pub count: f64,
}

impl Default for Moments {
    fn default() -> Self {
        Self { mean: 0.0, variance: 1.0, count: 1e-4 }
    }
}

impl Moments {
    /// Adds numbers, at least one.
    pub fn add(&mut self, numbers: &[f64]) {
        let added = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / added;
        let variance = numbers.iter().map(|number| (number - mean).powi(2)).sum::<f64>() / added;
        let (difference, count) = (mean - self.mean, self.count + added);
        let between = difference * difference * self.count * added / count;
        self.variance = (self.variance * self.count + variance * added + between) / count;
        self.mean += difference * added / count;
        self.count = count;
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;

    use super::*;

    #[test]
    fn heads_are_drawn_by_their_chances_or_uniformly_and_the_best_is_the_first_of_equal_ones() {
        let mut random = generator(1);
        let mut meta = MetaPolicy::new(3, &mut random);
        assert!(meta.scores.iter().all(|score| score.abs() < 0.05));
        meta.scores = vec![0.0, 2.0_f64.ln(), 0.0];
        for (uniform, want) in [(false, [0.25, 0.5, 0.25]), (true, [1.0 / 3.0; 3])] {
            let mut drawn = [0.0_f64; 3];
            for _ in 0..20_000 {
                meta.draw(uniform, &mut random);
                drawn[meta.head] += 1.0 / 20_000.0;
            }
            assert!((0..3).all(|head| (drawn[head] - want[head]).abs() < 0.015), "{drawn:?}");
        }
        for (head, mean) in [-2.0, 1.0, 1.0].into_iter().enumerate() {
            meta.returns[head].mean = mean;
        }
        assert_eq!(meta.best(), 1);
    }
}
