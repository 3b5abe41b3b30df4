//! Choosing an action from utilities.

use crate::policy::{DecideError, Decision};

/// The available action of the largest utility, the lowest index on ties. NaN never wins.
///
/// `available[u]` is 0 where action u is not available; both slices have one entry per action.
#[inline]
pub fn masked_argmax(utilities: &[f32], available: &[u16]) -> Result<Decision, DecideError> {
    if utilities.len() != available.len() {
        return Err(DecideError::BadLength);
    }
    let mut best: Option<Decision> = None;
    let mut any = false;
    for ((action, &utility), &code) in (0..).zip(utilities).zip(available) {
        if code == 0 {
            continue;
        }
        any = true;
        let better = match best {
            Some(best) => utility > best.utility,
            None => !utility.is_nan(),
        };
        if better {
            best = Some(Decision { action, utility });
        }
    }
    let none = if any { DecideError::NonFinite } else { DecideError::NoAvailableAction };
    best.ok_or(none)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_the_lowest_index_on_ties() {
        let choice = masked_argmax(&[1.0, 3.0, 3.0, 2.0], &[1; 4]);
        assert_eq!(choice, Ok(Decision { action: 1, utility: 3.0 }));
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
}
