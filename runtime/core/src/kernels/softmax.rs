//! Attention weights of one query.

use super::dot::{LANES, join};
use crate::math::exp;

/// The number of each lane, as wide as a score: so the compiler compares whole vectors.
const LANE: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// The slots that `count` scores need: whole vectors.
pub const fn slots(count: usize) -> usize {
    count.div_ceil(LANES) * LANES
}

/// Scores of one query among several.
#[derive(Debug)]
pub struct Scores<'a> {
    /// The scores, whole vectors.
    pub scores: &'a mut [f32],
    /// How many there are.
    pub count: usize,
    /// Whether all are finite, which is found out.
    pub finite: bool,
}

/// Turns the first `count` scores into weights that add up to one, and what stands behind them into zeros.
/// Returns false where a score is not finite. `largest_of` is [`largest`], in whichever order.
#[inline(always)]
pub fn softmax(scores: &mut [f32], count: usize, largest_of: impl Fn([f32; LANES]) -> f32) -> bool {
    let (chunks, _) = scores.as_chunks_mut::<LANES>();
    let mut magnitudes = [0; LANES];
    let mut largest = [f32::MIN; LANES];
    for (first, chunk) in (0..).step_by(LANES).zip(chunks.iter_mut()) {
        let scores = count.saturating_sub(first) as u32;
        for (score, lane) in chunk.iter_mut().zip(LANE) {
            *score = if lane < scores { *score } else { f32::MIN };
        }
        for ((score, magnitude), largest) in chunk.iter().zip(&mut magnitudes).zip(&mut largest) {
            *magnitude = u32::max(*magnitude, score.to_bits() & 0x7fff_ffff);
            *largest = if *score > *largest { *score } else { *largest };
        }
    }
    let largest = largest_of(largest);
    let mut sums = [0.0; LANES];
    for (first, chunk) in (0..).step_by(LANES).zip(chunks.iter_mut()) {
        let scores = count.saturating_sub(first) as u32;
        for ((score, lane), sum) in chunk.iter_mut().zip(LANE).zip(&mut sums) {
            let power = exp(*score - largest);
            *score = if lane < scores { power } else { 0.0 };
            *sum += *score;
        }
    }
    let scale = 1.0 / join(sums);
    for weights in chunks {
        weights.iter_mut().for_each(|weight| *weight *= scale);
    }
    magnitudes.iter().fold(0, |a, &b| u32::max(a, b)) < 0x7f80_0000
}

/// The largest of numbers that are finite.
#[inline(always)]
pub fn largest(lanes: [f32; LANES]) -> f32 {
    lanes.iter().fold(f32::MIN, |a, &b| if b > a { b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    #[test]
    fn one_score_has_weight_one() {
        for score in [0.0, -3.0e30, 17.25] {
            let mut scores = [f32::NAN; 16];
            scores[0] = score;
            assert!(softmax(&mut scores, 1, largest));
            assert_eq!((scores[0], &scores[1..]), (1.0, [0.0; 15].as_slice()));
        }
    }

    #[test]
    fn equal_scores_share() {
        for count in 1..=64 {
            let mut scores = vec![5.0; slots(count)];
            assert!(softmax(&mut scores, count, largest));
            let share = 1.0 / count as f32;
            assert!(scores[..count].iter().all(|&weight| weight == share));
            assert!(scores[count..].iter().all(|&weight| weight == 0.0));
        }
    }

    #[test]
    fn refuses_what_is_not_finite() {
        for bad in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            for place in 0..20 {
                let mut scores = [0.5; 32];
                scores[place] = bad;
                assert!(!softmax(&mut scores, 20, largest));
                scores = [0.5; 32];
                scores[20 + place % 12] = bad;
                assert!(softmax(&mut scores, 20, largest));
            }
        }
    }
}
