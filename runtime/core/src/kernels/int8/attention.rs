//! Attention over rows of integers: what bounds them, and how sums of them become short again.

/// Rows of int16 that stand somewhere in a matrix.
#[derive(Clone, Copy, Debug)]
pub struct IntegerRows<'a> {
    /// The matrix.
    pub integers: &'a [i16],
    /// Columns of a row, a multiple of [`super::INPUTS`]; those behind the real ones are zero.
    pub width: usize,
    /// What an integer of each row of the matrix counts.
    pub steps: &'a [f32],
    /// Which of the rows are meant, one after the other.
    pub slots: &'a [u16],
}

impl<'a> IntegerRows<'a> {
    /// The row in a slot and what its integers count; nothing where there is none.
    #[inline(always)]
    pub fn row(&self, slot: u16) -> (&'a [i16], f32) {
        let (index, start) = (usize::from(slot), usize::from(slot) * self.width);
        let row = self.integers.get(start..start + self.width).unwrap_or(&[]);
        (row, self.steps.get(index).copied().unwrap_or(0.0))
    }

    /// Of the rows in one slot or two `COUNT` parts of so many columns, from a first part on; where there is no second slot the
    /// first row's once more, for a weight of zero.
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    #[inline(always)]
    pub(crate) fn two<const COLUMNS: usize, const COUNT: usize>(
        &self,
        slots: &[u16],
        part: usize,
    ) -> Option<[&'a [[i16; COLUMNS]; COUNT]; 2]> {
        let parts = |slot: u16| {
            // Far from overflow: slots and columns are numbers of 16 bits.
            let start = usize::from(slot).wrapping_mul(self.width / COLUMNS).wrapping_add(part);
            self.integers.as_chunks().0.get(start..)?.first_chunk()
        };
        let first = slots.first()?;
        Some([parts(*first)?, parts(*slots.get(1).unwrap_or(first))?])
    }
}

/// The largest absolute value of an integer in a row, and of one that it is compared with: 32,767 halved until `width` products
/// of two cannot leave i32.
#[inline(always)]
pub const fn row_max(width: usize) -> u16 {
    halved(width, None)
}

/// The largest absolute value of a weight by which `count` rows of so many columns are mixed: halved likewise.
#[inline(always)]
pub const fn mixing_max(count: usize, width: usize) -> u16 {
    halved(count, Some(row_max(width)))
}

/// 32,767, halved until `terms` products with factors up to `other`, or up to itself, cannot leave i32.
#[inline(always)]
const fn halved(terms: usize, other: Option<u16>) -> u16 {
    let mut most = i16::MAX as u16;
    while most > 1 {
        let other = match other {
            Some(other) => other,
            None => most,
        };
        if (terms as u64).saturating_mul(most as u64 * other as u64) <= i32::MAX as u64 {
            break;
        }
        most /= 2;
    }
    most
}

/// Makes int16 of sums by halving all of them as often as is needed, rounding to the nearest, up: none is larger than `most`
/// in absolute value. Returns what an integer counts of what a sum counts, a power of two. Integers behind the sums are zero.
#[inline(always)]
pub fn narrow(sums: &[i32], most: u16, integers: &mut [i16]) -> f32 {
    // Of negative sums one less, which is as good: halves are rounded up.
    let magnitudes = sums.iter().map(|sum| (sum ^ (sum >> 31)) as u32);
    let largest = magnitudes.fold(0, u32::max);
    let most = u32::from(most.max(1));
    // So that the largest has no more bits than the most.
    let halvings = most.leading_zeros().saturating_sub(largest.leading_zeros());
    // Rounding may add one.
    let halvings = (halvings + u32::from(largest >> halvings >= most)).min(31);
    let half = (1_i32 << halvings) >> 1;
    let (to, behind) = integers.split_at_mut(sums.len().min(integers.len()));
    for (integer, sum) in to.iter_mut().zip(sums) {
        // Never wraps, see [`row_max`].
        *integer = (sum.wrapping_add(half) >> halvings) as i16;
    }
    behind.fill(0);
    f32::from_bits((127 + halvings) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::int8::input_max;

    #[test]
    fn no_sum_of_rows_leaves_i32() {
        let most = i64::from(i32::MAX);
        for width in [1, 2, 8, 32, 64, 96, 128, 512, 1024, 65_536] {
            let row = i64::from(row_max(width));
            assert!(row >= 1 && width as i64 * row * row <= most, "{width}: {row}");
            for count in [1, 2, 11, 64, 128] {
                let weight = i64::from(mixing_max(count, width));
                assert!(weight >= 1 && count as i64 * weight * row <= most, "{count}, {width}");
            }
        }
        assert_eq!(
            [row_max(2), row_max(32), row_max(64), row_max(128)],
            [32_767, 8_191, 4_095, 4_095]
        );
        assert_eq!([mixing_max(11, 128), mixing_max(128, 128)], [32_767, 4_095]);
    }

    #[test]
    fn rounding_leaves_no_sum_of_rows_outside_of_i32() {
        for width in [1, 2, 8, 32, 64, 96, 128, 512, 1024, 65_536] {
            for count in 1..=128 {
                let weight = u64::from(mixing_max(count, width));
                let largest = count as u64 * weight * u64::from(row_max(width));
                let halvings = halvings(largest, input_max(width));
                assert!(largest + (1 << halvings) / 2 <= i32::MAX as u64, "{count}, {width}");
            }
        }
    }

    /// How often a sum is halved until it is smaller than the most.
    fn halvings(largest: u64, most: u16) -> u32 {
        (0..64).find(|halvings| largest >> halvings < most.into()).expect("zero is smaller")
    }

    #[test]
    fn sums_become_the_nearest_short_integers() {
        for (largest, most, step) in [
            (0, 32_767, 1.0),
            (32_766, 32_767, 1.0),
            (32_767, 32_767, 2.0),
            // As large as sums of products get.
            (128 * 4_095 * 4_095, 32_767, 65_536.0),
            (5_000, 1_000, 8.0),
        ] {
            let sums = [largest, -largest, largest / 3, 1, 0];
            let mut integers = [9; 8];
            assert_eq!(narrow(&sums, most, &mut integers), step, "{largest}");
            for (sum, integer) in sums.iter().zip(integers) {
                let error = f64::from(*sum) - f64::from(integer) * f64::from(step);
                assert!(error.abs() <= f64::from(step) / 2.0, "{sum} became {integer}");
                assert!(integer.unsigned_abs() <= most);
            }
            assert_eq!(integers[5..], [0; 3]);
        }
        for largest in [0, 1, 99, 100, 101, 199, 200, 4_095, 4_096, 65_535, 1 << 30] {
            for most in [2, 100, 255, 16_384, 32_767] {
                let step = (1_u64 << halvings(largest as u64, most)) as f32;
                for sum in [largest, -largest - 1] {
                    let mut integers = [0; 2];
                    assert_eq!(narrow(&[sum, 0], most, &mut integers), step, "{sum}, {most}");
                    assert!(integers[0].unsigned_abs() <= most, "{sum}, {most}: {integers:?}");
                }
            }
        }
        // Halves are rounded up.
        let mut integers = [0; 2];
        assert_eq!((narrow(&[3, -3], 3, &mut integers), integers), (2.0, [2, -1]));
    }
}
