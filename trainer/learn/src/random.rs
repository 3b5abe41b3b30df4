//! Draws from a seeded generator.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// The generator of every random choice in this crate.
pub type Generator = Xoshiro256PlusPlus;

/// A generator of its own for each purpose of a run, so that one does not shift another.
pub fn generator(seed: u64, purpose: u64) -> Generator {
    let mut mixer = Generator::seed_from_u64(seed);
    let base = mixer.next_u64();
    Generator::seed_from_u64(base ^ purpose.wrapping_mul(0x9E37_79B9_7F4A_7C15))
}

/// Uniform in 0..1, of 24 random bits.
pub fn uniform(generator: &mut impl Rng) -> f32 {
    (generator.next_u32() >> 8) as f32 / (1u32 << 24) as f32
}

/// Uniform among `0..count` by multiplication; the bias is below `count / 2^32`. `count` is not 0.
pub fn below(generator: &mut impl Rng, count: usize) -> usize {
    ((u64::from(generator.next_u32()) * count as u64) >> 32) as usize
}
