//! Attention weights of one query.

use super::dot::sum;
use super::nonzero::all_finite;
use crate::math::exp;

/// Turns scores into weights that add up to one. Returns false where a score is not finite.
#[inline(always)]
pub fn softmax(scores: &mut [f32]) -> bool {
    if !all_finite(scores) {
        return false;
    }
    let largest = scores.iter().fold(f32::MIN, |a, &b| if b > a { b } else { a });
    for score in scores.iter_mut() {
        *score = exp(*score - largest);
    }
    let scale = 1.0 / sum(scores);
    for weight in scores.iter_mut() {
        *weight *= scale;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_score_has_weight_one() {
        for score in [0.0, -3.0e30, 17.25] {
            let mut scores = [score];
            assert!(softmax(&mut scores));
            assert_eq!(scores, [1.0]);
        }
    }

    #[test]
    fn equal_scores_share() {
        let mut scores = [5.0; 4];
        assert!(softmax(&mut scores));
        assert_eq!(scores, [0.25; 4]);
    }

    #[test]
    fn refuses_what_is_not_finite() {
        assert!(!softmax(&mut [0.0, f32::INFINITY]));
        assert!(!softmax(&mut [f32::NAN]));
    }
}
