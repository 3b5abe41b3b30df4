//! Draws from a seeded generator: the same bits on every target.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::observation::{EntitySet, members};

/// The generator that all random choices come from.
pub type Random = Xoshiro256PlusPlus;

/// The generator of one instance: the same seed gives the same draws everywhere.
pub fn generator(seed: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed)
}

/// The [stream] of what is measured on: it must not shift with what training draws.
pub const EVALUATION: u64 = 4;

/// One of the generators of a seed: each stream has its own numbers, and each index of a stream.
pub fn stream(seed: u64, stream: u64, index: u64) -> Random {
    let mut mixer = generator(seed);
    let mut mix = |word: u64| mixer.next_u64() ^ word.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let base = mix(stream);
    generator(base ^ mix(index))
}

/// An episode to be measured on, by its number: what the world draws from, and what the team draws from.
pub fn episode(seed: u64, number: usize) -> (Random, Random) {
    let mut team = stream(seed, EVALUATION, number as u64);
    (generator(team.next_u64()), team)
}

/// A uniform integer in `0..bound`; 0 where the bound is 0.
///
/// Scaling 64 bits leaves a bias below `bound / 2^64`, far from measurable.
pub fn below(rng: &mut Xoshiro256PlusPlus, bound: usize) -> usize {
    ((u128::from(rng.next_u64()) * bound as u128) >> 64) as usize
}

/// A uniform number in `[0, 1)` with 53 random bits.
pub fn unit(rng: &mut Xoshiro256PlusPlus) -> f64 {
    const STEP: f64 = 1.0 / (1u64 << 53) as f64;
    (rng.next_u64() >> 11) as f64 * STEP
}

/// A uniform choice among the members of a set of bits; `None` where it is empty.
pub fn member(rng: &mut Random, set: EntitySet) -> Option<usize> {
    let chosen = below(rng, set.count_ones() as usize);
    members(set).nth(chosen)
}

/// Puts a list into a random order (Fisher and Yates 1938).
pub fn shuffle<T>(rng: &mut Random, list: &mut [T]) {
    (1..list.len()).rev().for_each(|last| list.swap(last, below(rng, last + 1)));
}

/// True with the given probability.
pub fn chance(rng: &mut Xoshiro256PlusPlus, probability: f64) -> bool {
    unit(rng) < probability
}
