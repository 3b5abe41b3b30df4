//! Actions drawn by their scores.

use sortie_envs::Random;
use sortie_envs::random::unit;
use sortie_nn::layers::softmax;

use super::groups::{Group, Groups, Rows};

/// Where drawn actions come from.
pub trait Draw {
    /// Draws an action for every row of every group, by the scores of actions `[rows, actions]`.
    fn draw(&mut self, groups: &Groups, scores: &Rows) -> Vec<Vec<u32>>;

    /// Adds Gumbel's noise to scores, whose largest is then drawn by their softmax; none unless there is chance in it.
    fn shake(&mut self, scores: &mut [f32]) {
        let _ = scores;
    }
}

impl Draw for Random {
    fn draw(&mut self, groups: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
        let mut chances = Vec::new();
        let mut of_group = |(group, scores): (&Group, &Vec<f32>)| {
            let rows = scores.chunks_exact(group.actions);
            rows.map(|scores| {
                chances.clear();
                chances.extend_from_slice(scores);
                softmax::forward(&mut chances);
                drawn(&chances, unit(self) as f32)
            })
            .collect()
        };
        groups.0.iter().zip(scores).map(&mut of_group).collect()
    }

    fn shake(&mut self, scores: &mut [f32]) {
        for score in scores {
            let number = unit(self).max(f64::MIN_POSITIVE);
            *score -= (-number.ln()).ln() as f32;
        }
    }
}

/// The best action of every row of every group.
pub(crate) fn best_of_all(groups: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
    let all = groups.0.iter().zip(scores);
    all.map(|(of, scores)| scores.chunks_exact(of.actions).map(best).collect()).collect()
}

/// The first of the largest.
pub(crate) fn best(scores: &[f32]) -> u32 {
    let largest = scores.iter().enumerate().reduce(|a, b| if b.1 > a.1 { b } else { a });
    largest.map_or(0, |(action, _)| action as u32)
}

/// The action whose share of 0..1 a number falls into.
pub(crate) fn drawn(chances: &[f32], mut number: f32) -> u32 {
    for (action, chance) in chances.iter().enumerate() {
        if number < *chance {
            return action as u32;
        }
        number -= chance;
    }
    (0..chances.len()).rev().find(|action| chances[*action] > 0.0).unwrap_or(0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_drawn_by_their_chances() {
        for (number, action) in [(0.0, 1), (0.24, 1), (0.26, 2), (0.99, 2), (1.0, 2)] {
            assert_eq!(drawn(&[0.0, 0.25, 0.75, 0.0], number), action, "{number}");
        }
    }

    #[test]
    fn the_largest_of_shaken_scores_is_drawn_by_their_softmax() {
        let mut random = sortie_envs::random::generator(1);
        let chances = [0.1_f32, 0.6, 0.3];
        let mut drawn = [0; 3];
        for _ in 0..20_000 {
            let mut scores = chances.map(f32::ln);
            random.shake(&mut scores);
            drawn[best(&scores) as usize] += 1;
        }
        for (count, chance) in drawn.into_iter().zip(chances) {
            assert!((count as f32 / 20_000.0 - chance).abs() < 0.015, "{drawn:?}");
        }
    }
}
