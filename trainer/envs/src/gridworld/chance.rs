//! What is left to chance.

use alloc::sync::Arc;

use rand_core::Rng;

use super::ACTION_NAMES;
use crate::random::Random;

/// Where all that is left to chance comes from: a generator, or a recording.
pub trait Chance {
    /// The action that an agent takes that was told to take one.
    fn taken(&mut self, agent: usize, action: u8) -> u8;

    /// Step `tick` of a pit that opens with this probability: what is added to it where it stays closed.
    fn tick(&mut self, pit: usize, tick: u32, probability: f64, magnitude: f64) -> Option<f64>;

    /// Whether the first of two agents that want the same cell goes back.
    fn first_goes_back(&mut self) -> bool;
}

/// Chance out of a generator.
pub(super) struct Drawn<'a> {
    pub(super) random: &'a mut Random,
    pub(super) noise: f64,
    pub(super) normals: &'a Normals,
}

impl Chance for Drawn<'_> {
    /// Both halves of one number: whether the action is replaced, and by which.
    #[inline]
    fn taken(&mut self, _: usize, action: u8) -> u8 {
        let number = self.random.next_u64();
        let is_replaced = ((number >> 32) as f64) < self.noise * (1_u64 << 32) as f64;
        let other = (((number & 0xffff_ffff) * ACTION_NAMES.len() as u64) >> 32) as u8;
        if is_replaced { other } else { action }
    }

    /// The high bits of one number say whether it opens, the low ones by how much the probability grows.
    #[inline]
    fn tick(&mut self, _: usize, _: u32, probability: f64, magnitude: f64) -> Option<f64> {
        const STEP: f64 = 1.0 / (1_u64 << 52) as f64;
        let number = self.random.next_u64();
        let opens = ((number >> 12) as f64) * STEP < probability;
        (!opens).then(|| magnitude + magnitude * self.normals.at(number as usize))
    }

    fn first_goes_back(&mut self) -> bool {
        self.random.next_u64() >> 63 == 0
    }
}

/// Standard normal numbers, all equally likely: the middles of so many slices of the same probability.
#[derive(Clone, Debug)]
pub struct Normals(Arc<[f32]>);

impl Normals {
    /// How many there are.
    pub const COUNT: usize = 1 << 12;

    /// Finds them by Newton's method, from the middle outwards: each begins where the one before it is.
    pub fn new() -> Self {
        let mut normals = [0.0_f32; Self::COUNT];
        let (half, mut value) = (Self::COUNT / 2, 0.0_f64);
        for place in 0..half {
            let above = (place as f64 + 0.5) / Self::COUNT as f64;
            for _ in 0..8 {
                let reached = 0.5 * libm::erf(value * core::f64::consts::FRAC_1_SQRT_2);
                let density = libm::exp(-0.5 * value * value) / libm::sqrt(core::f64::consts::TAU);
                value += (above - reached) / density;
            }
            normals[half + place] = value as f32;
            normals[half - 1 - place] = -value as f32;
        }
        Self(normals.to_vec().into())
    }

    /// One of them by a number, of which only the last bits count.
    #[inline]
    pub fn at(&self, number: usize) -> f64 {
        self.0[number & (Self::COUNT - 1)].into()
    }
}

impl Default for Normals {
    fn default() -> Self {
        Self::new()
    }
}
