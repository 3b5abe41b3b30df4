//! Elementary functions as fixed polynomials, so that every target computes the same bits.
//!
//! The system's own functions differ between platforms in their last bits; these use only additions and
//! multiplications in a stated order, without fused multiply-add.

// The coefficients stand as they are published.
#![allow(clippy::excessive_precision)]

mod angle;

pub use angle::{cosine, sine};

/// Smallest argument of [`exp`]; below it the result stays at e⁻⁸⁷, the last normal power.
const EXP_MIN: f32 = -87.0;
/// Largest argument of [`exp`] whose result is finite.
const EXP_MAX: f32 = 88.0;
/// 1.5 · 2²³: adding and subtracting it rounds to the nearest integer, ties to even.
const ROUND: f32 = 12_582_912.0;
/// ln 2 in two parts; the first has few bits, so that its integer multiples are exact.
const LN2_HIGH: f32 = 0.693_359_375;
const LN2_LOW: f32 = -2.121_944_4e-4;

/// e to the power of `x`, within two units in the last place; arguments are clamped to [-87, 88].
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let x = if x > EXP_MIN { x } else { EXP_MIN };
    let x = if x < EXP_MAX { x } else { EXP_MAX };
    let shifted = x * core::f32::consts::LOG2_E + ROUND;
    let power = shifted - ROUND;
    let rest = (x - power * LN2_HIGH) - power * LN2_LOW;
    let mantissa = beyond_linear(rest) + (rest + 1.0);
    // The low bits of `shifted` hold the rounded power; moved up, they become the exponent.
    let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    mantissa * f32::from_bits(exponent)
}

/// eˣ - 1 - x for |x| up to half of ln 2.
#[inline(always)]
fn beyond_linear(x: f32) -> f32 {
    let mut polynomial = 1.987_569_15e-4;
    for coefficient in [
        1.398_199_950_7e-3,
        8.333_451_907_3e-3,
        4.166_579_589_4e-2,
        1.666_666_545_9e-1,
        5.000_000_120_1e-1,
    ] {
        polynomial = polynomial * x + coefficient;
    }
    polynomial * x * x
}

/// eˣ - 1, within five units in the last place; arguments are clamped to [-87, 88].
#[inline(always)]
pub fn exp_minus_one(x: f32) -> f32 {
    let near_zero = beyond_linear(x) + x;
    if x.abs() < 0.34 { near_zero } else { exp(x) - 1.0 }
}

/// The arc tangent, within three units in the last place.
#[inline(always)]
pub fn arc_tangent(x: f32) -> f32 {
    /// The tangents of an eighth and of three eighths of half a turn.
    const NEAR: f32 = 0.414_213_56;
    const FAR: f32 = 2.414_213_6;
    let size = x.abs();
    let (angle, rest) = match () {
        () if size > FAR => (core::f32::consts::FRAC_PI_2, -1.0 / size),
        () if size > NEAR => (core::f32::consts::FRAC_PI_4, (size - 1.0) / (size + 1.0)),
        () => (0.0, size),
    };
    let square = rest * rest;
    let mut factor = -6.083_451_7e-2;
    for coefficient in [0.105_960_01, -0.142_438_49, 0.199_984_89, -0.333_333_16] {
        factor = factor * square + coefficient;
    }
    (angle + (rest * square * factor + rest)).copysign(x)
}

/// ln(1 + eˣ), within four units in the last place.
#[inline(always)]
pub fn softplus(x: f32) -> f32 {
    relu(x) + ln_of_one_and(exp(-x.abs()))
}

/// ln(1 + x) for x from 0 to 1: what the sum loses of x, the quotient gives back.
#[inline(always)]
fn ln_of_one_and(x: f32) -> f32 {
    let sum = 1.0 + x;
    let kept = sum - 1.0;
    if kept == 0.0 { x } else { ln(sum) * (x / kept) }
}

/// [`ln`] of any number: that of 0 is minus infinity, that of anything below is none.
#[inline(always)]
pub fn ln_of_any(x: f32) -> f32 {
    // A power of two that makes subnormal numbers normal.
    const LARGER: f32 = 16_777_216.0;
    const LN_LARGER: f32 = 16.635_532;
    if x >= f32::MIN_POSITIVE {
        if x < f32::INFINITY { ln(x) } else { x }
    } else if x > 0.0 {
        ln(x * LARGER) - LN_LARGER
    } else if x == 0.0 {
        f32::NEG_INFINITY
    } else {
        f32::NAN
    }
}

/// The natural logarithm of a normal positive number, within two units in the last place or 1e-7, whichever is more.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    // The mantissa goes to [√½, √2), so that what is left of 1 is small on both sides.
    const SQRT_HALF: u32 = 0x3f35_04f3;
    let moved = x.to_bits().wrapping_sub(SQRT_HALF);
    let power = (moved as i32 >> 23) as f32;
    let rest = f32::from_bits((moved & 0x007f_ffff).wrapping_add(SQRT_HALF)) - 1.0;
    let mut polynomial = 7.037_683_629_2e-2;
    for coefficient in [
        -1.151_461_031_0e-1,
        1.167_699_874_0e-1,
        -1.242_014_084_6e-1,
        1.424_932_278_7e-1,
        -1.666_805_766_5e-1,
        2.000_071_476_5e-1,
        -2.499_999_399_3e-1,
        3.333_333_117_4e-1,
    ] {
        polynomial = polynomial * rest + coefficient;
    }
    let square = rest * rest;
    let bent = polynomial * rest * square + power * LN2_LOW - 0.5 * square;
    rest + bent + power * LN2_HIGH
}

/// 1 / (1 + e⁻ˣ), within three units in the last place. `x` is a number: NaN gives some value in [0, 1].
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    // The power of a negative argument never overflows, on whichever side of zero `x` lies.
    let power = exp(-x.abs());
    let numerator = if x < 0.0 { power } else { 1.0 };
    numerator / (1.0 + power)
}

/// The hyperbolic tangent, within three units in the last place. `x` is a number: NaN gives NaN or ±1.
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    let size = x.abs();
    let square = size * size;
    let mut polynomial = -5.704_988_727_45e-3;
    for coefficient in
        [2.063_908_879_54e-2, -5.373_971_555_31e-2, 1.333_144_220_36e-1, -3.333_328_194_22e-1]
    {
        polynomial = polynomial * square + coefficient;
    }
    let near_zero = polynomial * square * size + size;
    let far = 1.0 - 2.0 / (exp(2.0 * size) + 1.0);
    let value = if size < 0.625 { near_zero } else { far };
    value.copysign(x)
}

/// The square root, the nearest number to it.
#[inline(always)]
pub fn square_root(x: f32) -> f32 {
    // That of `libm` is an instruction from before there were wide registers, and waits until their upper halves are put
    // aside: a hundred cycles behind each kernel.
    #[cfg(feature = "std")]
    let root = x.sqrt();
    #[cfg(not(feature = "std"))]
    let root = libm::sqrtf(x);
    root
}

/// The larger of `x` and +0; NaN stays NaN, so that an overflow is still seen at the end.
#[inline(always)]
pub fn relu(x: f32) -> f32 {
    if x < 0.0 { 0.0 } else { x }
}

/// [`relu`] of every value.
#[inline(always)]
pub fn relu_all(values: &mut [f32]) {
    for value in values {
        *value = relu(*value);
    }
}

/// Whether every value is a finite number.
#[inline(always)]
pub fn all_finite(values: &[f32]) -> bool {
    let magnitude = |value: &f32| value.to_bits() & 0x7fff_ffff;
    values.iter().map(magnitude).fold(0, u32::max) < 0x7f80_0000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_close_everywhere_and_exact_at_zero() {
        assert_eq!(exp(0.0), 1.0);
        for step in -87_000..88_000 {
            let x = step as f32 / 1000.0;
            let want = f64::from(x).exp();
            let error = (f64::from(exp(x)) - want).abs() / want;
            assert!(error < 2.5e-7, "exp({x}): relative error {error}");
        }
    }

    #[test]
    fn exp_clamps_instead_of_overflowing() {
        assert_eq!(exp(-1e30), exp(-87.0));
        assert!(exp(1e30).is_finite());
    }

    #[test]
    fn ln_is_close_everywhere_and_exact_at_one() {
        assert_eq!(ln(1.0), 0.0);
        let mut x = f32::MIN_POSITIVE;
        while x < f32::MAX / 1.01 {
            let want = f64::from(x).ln();
            let error = (f64::from(ln(x)) - want).abs() / want.abs().max(0.5);
            assert!(error < 2.5e-7, "ln({x}): error {error}");
            x *= 1.000_37;
        }
        for below_one in 1..1000 {
            let x = 1.0 - below_one as f32 / 16_777_216.0;
            let error = f64::from(ln(x)) / f64::from(x).ln() - 1.0;
            assert!(error.abs() < 2.5e-7, "ln({x}): relative error {error}");
        }
    }

    #[test]
    fn sigmoid_and_tanh_are_close_everywhere() {
        for step in -87_000..95_000 {
            let x = step as f32 / 1000.0;
            let wide = f64::from(x);
            let want = 1.0 / (1.0 + (-wide).exp());
            let error = (f64::from(sigmoid(x)) - want).abs() / want;
            assert!(error < 3.5e-7, "sigmoid({x}): relative error {error}");
            let want = wide.tanh();
            let error = (f64::from(tanh(x)) - want).abs() / want.abs().max(1e-30);
            assert!(error < 2.5e-7, "tanh({x}): relative error {error}");
        }
    }

    #[test]
    fn sigmoid_and_tanh_reach_their_limits() {
        for (x, low, high) in [(f32::MAX, 1.0, 1.0), (f32::INFINITY, 1.0, 1.0), (0.0, 0.5, 0.0)] {
            assert_eq!((sigmoid(x), tanh(x)), (low, high));
        }
        assert_eq!(tanh(f32::MIN), -1.0);
        assert!(sigmoid(f32::MIN) >= 0.0 && sigmoid(f32::MIN) < 1e-37);
        assert_eq!(tanh(-0.0).to_bits(), (-0.0_f32).to_bits());
    }

    #[test]
    fn relu_keeps_nan() {
        assert!(relu(f32::NAN).is_nan());
        assert_eq!(relu(-3.0), 0.0);
        assert_eq!(relu(2.0), 2.0);
    }

    #[test]
    fn finds_what_is_not_finite() {
        assert!(all_finite(&[0.0, -1.0, f32::MAX]));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(!all_finite(&[0.0, bad, 1.0]));
        }
    }
}
