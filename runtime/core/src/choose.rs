//! Choosing an action from utilities.

use core::hint::select_unpredictable;

use crate::math::exp;
use crate::policy::{DecideError, Decision};

/// The available action of the largest utility, the lowest index on ties. NaN never wins.
///
/// `available[u]` is 0 where action u is not available; both slices have one entry per action.
#[inline]
pub fn masked_argmax(utilities: &[f32], available: &[u16]) -> Result<Decision, DecideError> {
    if utilities.len() != available.len() {
        return Err(DecideError::BadLength);
    }
    let (mut best, mut best_action, mut any) = (NO_NUMBER, 0, false);
    for (action, (utility, code)) in utilities.iter().zip(available).enumerate() {
        let order = order(*utility);
        let better = (*code != 0) & (order > best);
        best = select_unpredictable(better, order, best);
        best_action = select_unpredictable(better, action, best_action);
        any |= *code != 0;
    }
    match utilities.get(best_action) {
        Some(&utility) if best > NO_NUMBER => Ok(Decision { action: best_action as u16, utility }),
        _ if any => Err(DecideError::NonFinite),
        _ => Err(DecideError::NoAvailableAction),
    }
}

/// The order of NaN: before all numbers.
const NO_NUMBER: i32 = i32::MIN;

/// An integer that is larger for larger numbers, and the same for both zeros.
#[inline]
fn order(number: f32) -> i32 {
    let bits = (number + 0.0).to_bits() as i32;
    if number.is_nan() { NO_NUMBER } else { bits ^ (bits >> 31 & i32::MAX) }
}

/// An action drawn from the softmax of the available actions' logits; `random` is 32 random bits.
///
/// The same bits give the same action on every target. A logit that is not finite is never drawn.
pub fn masked_sample(
    logits: &[f32],
    available: &[u16],
    random: u32,
) -> Result<Decision, DecideError> {
    let largest = masked_argmax(logits, available)?;
    let shares = || {
        let actions = (0_u16..).zip(logits).zip(available);
        let open = actions.filter(|((_, logit), code)| **code != 0 && logit.is_finite());
        open.map(|((action, &utility), _)| {
            (Decision { action, utility }, exp(utility - largest.utility))
        })
    };
    let total: f32 = shares().map(|(_, share)| share).fold(0.0, |sum, share| sum + share);
    // 24 bits are what an f32 holds: a number in [0, 1), every step equally likely.
    let mut left = (random >> 8) as f32 / (1 << 24) as f32 * total;
    let mut last = None;
    for (decision, share) in shares() {
        if left < share {
            return Ok(decision);
        }
        left -= share;
        last = Some(decision);
    }
    // Rounding may leave a rest behind the last share.
    last.ok_or(DecideError::NonFinite)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_the_lowest_index_on_ties() {
        let choice = masked_argmax(&[1.0, 3.0, 3.0, 2.0], &[1; 4]);
        assert_eq!(choice, Ok(Decision { action: 1, utility: 3.0 }));
        let choice = masked_argmax(&[-1.0, -0.0, 0.0, f32::NEG_INFINITY], &[1; 4]);
        assert_eq!(choice, Ok(Decision { action: 1, utility: 0.0 }));
    }

    #[test]
    fn skips_what_is_not_available() {
        let choice = masked_argmax(&[1.0, 9.0, -3.0], &[0, 0, 7]);
        assert_eq!(choice, Ok(Decision { action: 2, utility: -3.0 }));
    }

    #[test]
    fn nan_never_wins() {
        let choice = masked_argmax(&[f32::NAN, -5.0, f32::NAN], &[1; 3]);
        assert_eq!(choice, Ok(Decision { action: 1, utility: -5.0 }));
        assert_eq!(masked_argmax(&[f32::NAN; 2], &[1; 2]), Err(DecideError::NonFinite));
    }

    #[test]
    fn no_available_action_is_an_error() {
        assert_eq!(masked_argmax(&[1.0, 2.0], &[0, 0]), Err(DecideError::NoAvailableAction));
        assert_eq!(masked_argmax(&[], &[]), Err(DecideError::NoAvailableAction));
        assert_eq!(masked_argmax(&[1.0], &[1, 1]), Err(DecideError::BadLength));
    }

    /// How often each action is drawn with `draws` evenly spaced random numbers.
    fn counts<const ACTIONS: usize>(
        logits: [f32; ACTIONS],
        available: [u16; ACTIONS],
        draws: u32,
    ) -> [u32; ACTIONS] {
        let mut counts = [0; ACTIONS];
        for draw in 0..draws {
            let random = (u64::from(draw) * (1 << 32) / u64::from(draws)) as u32;
            let decision = masked_sample(&logits, &available, random).unwrap();
            assert_eq!(decision.utility, logits[usize::from(decision.action)]);
            counts[usize::from(decision.action)] += 1;
        }
        counts
    }

    #[test]
    fn draws_as_often_as_the_softmax_says() {
        let logits = [0.0, 1.0, 9.0, -1.0];
        let drawn = counts(logits, [1, 3, 0, 1], 1 << 16);
        let shares = [1.0, 1.0_f64.exp(), 0.0, (-1.0_f64).exp()];
        let total: f64 = shares.iter().sum();
        for (drawn, share) in drawn.iter().zip(shares) {
            let want = f64::from(1 << 16) * share / total;
            assert!((f64::from(*drawn) - want).abs() < 2.0, "{drawn}, want {want}");
        }
    }

    #[test]
    fn logits_of_every_size_are_drawn_from() {
        assert_eq!(counts([f32::MAX, f32::MIN], [1, 1], 64), [64, 0]);
        assert_eq!(counts([f32::MIN; 4], [1; 4], 64), [16; 4]);
        assert_eq!(counts([f32::NEG_INFINITY, 2.0, f32::NAN], [1; 3], 64), [0, 64, 0]);
    }

    #[test]
    fn nothing_to_draw_from_is_an_error() {
        assert_eq!(masked_sample(&[1.0; 2], &[0; 2], 5), Err(DecideError::NoAvailableAction));
        assert_eq!(masked_sample(&[f32::NAN; 2], &[1; 2], 5), Err(DecideError::NonFinite));
        assert_eq!(masked_sample(&[f32::INFINITY; 2], &[1; 2], 5), Err(DecideError::NonFinite));
        assert_eq!(masked_sample(&[1.0; 2], &[1; 3], 5), Err(DecideError::BadLength));
    }
}
