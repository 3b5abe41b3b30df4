//! Seeded random numbers: the same bits on every target.

use rand_xoshiro::Xoshiro256PlusPlus;
pub use sortie_envs::random::stream;
use sortie_envs::random::unit;

/// The generator of every random choice of a trainer.
pub type Generator = Xoshiro256PlusPlus;

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
#[inline]
pub fn signed_unit(generator: &mut Generator) -> f32 {
    (2.0 * unit(generator) - 1.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_their_moments() {
        let numbers = normals(&mut stream(1, 1, 0), 100_001);
        assert_eq!(numbers.len(), 100_001);
        let mean = |power: i32| {
            numbers.iter().map(|x| f64::from(*x).powi(power)).sum::<f64>() / numbers.len() as f64
        };
        for (power, want) in [(1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0)] {
            assert!((mean(power) - want).abs() < 0.1, "moment {power}: {}", mean(power));
        }
    }
}
