//! Elementary functions as fixed polynomials, so that every target computes the same bits.
//!
//! The system's own functions differ between platforms in their last bits; these use only additions and
//! multiplications in a stated order, without fused multiply-add.

// The coefficients stand as they are published.
#![allow(clippy::excessive_precision)]

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
    let mut polynomial = 1.987_569_15e-4;
    for coefficient in [
        1.398_199_950_7e-3,
        8.333_451_907_3e-3,
        4.166_579_589_4e-2,
        1.666_666_545_9e-1,
        5.000_000_120_1e-1,
    ] {
        polynomial = polynomial * rest + coefficient;
    }
    let mantissa = polynomial * rest * rest + (rest + 1.0);
    // The low bits of `shifted` hold the rounded power; moved up, they become the exponent.
    let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    mantissa * f32::from_bits(exponent)
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
    fn relu_keeps_nan() {
        assert!(relu(f32::NAN).is_nan());
        assert_eq!(relu(-3.0), 0.0);
        assert_eq!(relu(2.0), 2.0);
    }
}
