//! Seeded generators, one for each purpose of a run.

use sortie_envs::Random;
use sortie_envs::random::unit;
use sortie_nn::random::{Generator, stream};

/// What random numbers are drawn for. Each purpose has its own stream, so that none shifts another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Initial weights.
    Weights = 1,
    /// Which records an update takes.
    Replay = 2,
    /// Episodes, exploration and allocation while training.
    Rollout = 3,
    /// Episodes to measure on.
    Evaluation = sortie_envs::random::EVALUATION,
    /// What a planner tries, and the chances that it assumes.
    Planning = 5,
    /// Choices of proposed allocations.
    Proposals = 6,
}

/// The generator of one purpose; `index` tells several of them apart.
pub fn generator(seed: u64, purpose: Purpose, index: u64) -> Generator {
    stream(seed, purpose as u64, index)
}

/// Draws a place of a list by its weight there, of which one at least is positive.
pub fn by_weight(rng: &mut Random, weights: &[f64]) -> usize {
    let mut left = unit(rng) * weights.iter().sum::<f64>();
    let drawn = weights.iter().position(|weight| {
        left -= weight;
        left < 0.0
    });
    // Rounding may leave something of the last weight.
    drawn.or_else(|| weights.iter().rposition(|weight| *weight > 0.0)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_core::Rng;

    #[test]
    fn streams_repeat_and_differ_by_seed_purpose_and_index() {
        let first = |seed, purpose, index| generator(seed, purpose, index).next_u64();
        let base = first(1, Purpose::Rollout, 0);
        assert_eq!(base, first(1, Purpose::Rollout, 0));
        for other in [
            first(2, Purpose::Rollout, 0),
            first(1, Purpose::Evaluation, 0),
            first(1, Purpose::Rollout, 1),
        ] {
            assert_ne!(base, other);
        }
    }
}
