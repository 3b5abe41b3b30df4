//! Which inputs are not zero: features and activations behind a ReLU have few that are.

/// A bit for each of 64 inputs, set where the input is not zero: the first 32 in the first word.
pub type Marks = [u32; 2];

/// Inputs of one [`Marks`].
pub const MARKED: usize = 64;

/// Values that are compared at once.
pub const LANES: usize = 8;

/// Marks the values that are not zero, and returns whether all are finite numbers. Marks are written for whole
/// groups of 64, as many as there are.
#[inline(always)]
pub fn mark(values: &[f32], marks: &mut [Marks]) -> bool {
    let mut magnitudes = [0; LANES];
    for (values, marks) in values.chunks(MARKED).zip(marks) {
        let mut bits = 0;
        let mut compare = |index: usize, lanes: &[f32; LANES]| {
            bits |= u64::from(lanes_not_zero(lanes)) << index;
            for (magnitude, value) in magnitudes.iter_mut().zip(lanes) {
                *magnitude = u32::max(*magnitude, value.to_bits() & 0x7fff_ffff);
            }
        };
        let (chunks, rest) = values.as_chunks();
        for (index, lanes) in (0..).step_by(LANES).zip(chunks) {
            compare(index, lanes);
        }
        if !rest.is_empty() {
            match values.last_chunk() {
                // Comparing some of them once more changes nothing.
                Some(lanes) => compare(values.len() - LANES, lanes),
                None => {
                    let mut lanes = [0.0; LANES];
                    for (lane, value) in lanes.iter_mut().zip(rest) {
                        *lane = *value;
                    }
                    compare(0, &lanes);
                }
            }
        }
        *marks = [bits as u32, (bits >> 32) as u32];
    }
    magnitudes.into_iter().fold(0, u32::max) < 0x7f80_0000
}

/// A bit for each value that is not zero.
#[inline(always)]
fn lanes_not_zero(values: &[f32; LANES]) -> u8 {
    let mut bits = 0;
    for (lane, value) in values.iter().enumerate() {
        bits |= u8::from(*value != 0.0) << lane;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    #[test]
    fn marks_what_is_not_zero() {
        for len in [0_usize, 1, 7, 8, 9, 31, 32, 63, 64, 65, 96, 128, 200] {
            let values: std::vec::Vec<f32> =
                (0..len).map(|i| if i % 3 == 0 { -0.0 } else { i as f32 }).collect();
            let mut marks = vec![[9; 2]; len.div_ceil(64)];
            assert!(mark(&values, &mut marks));
            for (index, value) in values.iter().enumerate() {
                let bit = marks[index / 64][index / 32 % 2] >> (index % 32) & 1;
                assert_eq!(bit == 1, *value != 0.0, "{index} of {len}");
            }
            let set: u32 = marks.iter().flatten().map(|word| word.count_ones()).sum();
            assert_eq!(set as usize, values.iter().filter(|value| **value != 0.0).count());
        }
    }

    #[test]
    fn marks_that_are_missing_are_not_written() {
        mark(&[1.0; 200], &mut [[0; 2]; 2]);
        mark(&[1.0; 200], &mut []);
    }

    #[test]
    fn finds_what_is_not_finite() {
        for len in [1, 7, 8, 12, 70, 130] {
            let mut marks = [[0; 2]; 3];
            let mut values = vec![f32::MAX; len];
            assert!(mark(&values, &mut marks));
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                for place in 0..len {
                    values.fill(0.5);
                    values[place] = bad;
                    assert!(!mark(&values, &mut marks), "{bad} at {place}");
                }
            }
        }
    }
}
