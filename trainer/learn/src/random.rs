//! Seeded generators, one for each purpose of a run.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
pub use sortie_envs::random::{below, chance, unit};

/// The generator of every random choice in this crate.
pub type Generator = Xoshiro256PlusPlus;

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
    Evaluation = 4,
    /// What a planner tries, and the chances that it assumes.
    Planning = 5,
    /// Choices of proposed allocations.
    Proposals = 6,
}

/// The generator of one purpose; `index` tells several of them apart.
pub fn generator(seed: u64, purpose: Purpose, index: u64) -> Generator {
    let mut mixer = Generator::seed_from_u64(seed);
    let mut mix = |word: u64| mixer.next_u64() ^ word.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let base = mix(purpose as u64);
    Generator::seed_from_u64(base ^ mix(index))
}

/// Standard normal numbers (Box and Muller 1958).
pub fn normals(generator: &mut Generator, count: usize) -> Vec<f32> {
    let mut numbers = Vec::with_capacity(count + 1);
    while numbers.len() < count {
        let radius = (-2.0 * (1.0 - unit(generator)).ln()).sqrt();
        let (sine, cosine) = (std::f64::consts::TAU * unit(generator)).sin_cos();
        numbers.extend([radius * cosine, radius * sine].map(|number| number as f32));
    }
    numbers.truncate(count);
    numbers
}

/// Uniform in -1..1.
pub fn signed_unit(generator: &mut Generator) -> f32 {
    (2.0 * unit(generator) - 1.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_their_moments() {
        let numbers = normals(&mut generator(1, Purpose::Weights, 0), 100_001);
        assert_eq!(numbers.len(), 100_001);
        let mean = |power: i32| {
            numbers.iter().map(|x| f64::from(*x).powi(power)).sum::<f64>() / numbers.len() as f64
        };
        for (power, want) in [(1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0)] {
            assert!((mean(power) - want).abs() < 0.1, "moment {power}: {}", mean(power));
        }
    }

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
