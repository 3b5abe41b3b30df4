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

/// Uniform in -1..1.
pub fn signed_unit(generator: &mut Generator) -> f32 {
    (2.0 * unit(generator) - 1.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

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
