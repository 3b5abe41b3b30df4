//! Sine and cosine, without double precision: a microcontroller would call functions for it.

use core::f32::consts::FRAC_PI_4;

/// Quarters in a radian, 2/π: 32 zeros, then its first 224 binary places.
const QUARTERS: [u32; 8] =
    [0, 0xa2f9_836e, 0x4e44_1529, 0xfc27_57d1, 0xf534_ddc0, 0xdb62_9599, 0x3c43_9041, 0xfe51_63ab];

/// Radians in a quarter, π/2, times 2³¹.
const QUARTER: u64 = 0xc90f_daa2;

/// The sine, within two units in the last place.
#[inline(always)]
pub fn sine(x: f32) -> f32 {
    let value = of_size(x.abs(), 0);
    if x.is_sign_negative() { -value } else { value }
}

/// The cosine, within the same.
#[inline(always)]
pub fn cosine(x: f32) -> f32 {
    of_size(x.abs(), 1)
}

/// The sine of an angle that is not negative and so many quarters of a turn further.
#[inline(always)]
fn of_size(x: f32, quarters: u32) -> f32 {
    let (passed, rest) = if x < FRAC_PI_4 { (0, x) } else { reduced(x) };
    let quarter = passed.wrapping_add(quarters);
    let square = rest * rest;
    let value = if quarter & 1 == 0 {
        let mut factor = 2.718_311_5e-6;
        for coefficient in [-1.983_933_5e-4, 8.333_329_4e-3, -0.166_666_67] {
            factor = factor * square + coefficient;
        }
        rest + rest * (square * factor)
    } else {
        let mut factor = 2.439_044_9e-5;
        for coefficient in [-1.388_676_4e-3, 4.166_662_3e-2] {
            factor = factor * square + coefficient;
        }
        1.0 - (0.5 * square - square * square * factor)
    };
    if quarter & 2 == 0 { value } else { -value }
}

/// The nearest quarter of a turn, counted modulo four, and the radians from there: a product of integers, of which a window of
/// 2/π decides the places that matter (Payne and Hanek). `x` is at least an eighth of a turn; what is no finite number gives NaN.
fn reduced(x: f32) -> (u32, f32) {
    let (mantissa, exponent) = (x.to_bits() & 0x007f_ffff | 0x0080_0000, x.to_bits() >> 23);
    let mantissa = u64::from(mantissa);
    // Places before this one are whole turns.
    let place = exponent.saturating_sub(120);
    let words = QUARTERS.get(place as usize / 32..).and_then(|words| words.first_chunk());
    let Some(&[a, b, c, d]) = words.filter(|_| x < f32::INFINITY) else {
        return (0, f32::NAN);
    };
    let word = |high: u32, low: u32| {
        let both = u64::from(high) << 32 | u64::from(low);
        both << (place % 32) >> 32
    };
    let low = mantissa * word(c, d);
    let middle = mantissa * word(b, c) + (low >> 32);
    let high = mantissa.wrapping_mul(word(a, b)).wrapping_add(middle >> 32);
    // Two places of quarters, 62 of a part of one.
    let turns = high << 32 | middle & 0xffff_ffff;
    let quarter = turns.wrapping_add(1 << 61) >> 62;
    let rest = (turns << 2) as i64;
    let zeros = rest.unsigned_abs().leading_zeros().min(63);
    let places = rest.unsigned_abs() << zeros >> 32;
    let radians = (places * QUARTER) as f32 * f32::from_bits((64 - zeros) << 23);
    (quarter as u32, if rest < 0 { -radians } else { radians })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_keep_their_sign_and_what_is_not_finite_has_no_sine() {
        assert_eq!([sine(0.0), sine(-0.0)].map(f32::to_bits), [0.0, -0.0].map(f32::to_bits));
        assert_eq!([cosine(0.0), cosine(-0.0)], [1.0, 1.0]);
        for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(sine(x).is_nan() && cosine(x).is_nan(), "{x}");
        }
        assert!(sine(f32::MAX).is_finite() && cosine(f32::MIN).is_finite());
    }
}
