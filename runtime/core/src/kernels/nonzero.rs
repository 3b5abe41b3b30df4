//! Lists of the inputs that are not zero: features and activations behind a ReLU have few.

/// The index of an input and the bits of its value.
pub type Nonzero = [u32; 2];

/// Writes the values that are not zero to `list`, at least as long as `values`, and returns their number.
#[inline(always)]
pub fn collect(values: &[f32], list: &mut [Nonzero]) -> usize {
    let mut count = 0;
    for (index, value) in values.iter().enumerate() {
        // Written always and counted where it stays: a branch here would be guessed wrong half the time.
        if let Some(slot) = list.get_mut(count) {
            *slot = [index as u32, value.to_bits()];
        }
        count += usize::from(*value != 0.0);
    }
    count.min(list.len())
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
    fn lists_what_is_not_zero() {
        let mut list = [[9; 2]; 4];
        let count = collect(&[0.0, 2.0, -0.0, -1.5], &mut list);
        assert_eq!(list[..count], [[1, 2.0_f32.to_bits()], [3, (-1.5_f32).to_bits()]]);
    }

    #[test]
    fn a_short_list_is_filled_and_no_more() {
        let mut list = [[0; 2]; 2];
        assert_eq!(collect(&[1.0; 5], &mut list), 2);
    }

    #[test]
    fn finds_what_is_not_finite() {
        assert!(all_finite(&[0.0, -1.0, f32::MAX]));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(!all_finite(&[0.0, bad, 1.0]));
        }
    }
}
