//! What an agent does without a decision.

use crate::policy::NO_ACTION;

/// The fallback action: the last one, else the declared safe one, else the lowest available;
/// [`NO_ACTION`] where none is.
pub(super) fn fallback_action(last: u16, safe: Option<u16>, available: &[u16]) -> u16 {
    first_available([Some(last), safe], available)
}

/// The action where a guard refused: what an agent did in a world that it knew may not be safe in this one, so the declared
/// safe one, else the last one, else the lowest available.
pub(super) fn guarded_action(last: u16, safe: Option<u16>, available: &[u16]) -> u16 {
    first_available([safe, Some(last)], available)
}

/// The action of an agent without a subtask: the declared safe one, else the lowest available.
pub(super) fn safe_action(safe: Option<u16>, available: &[u16]) -> u16 {
    first_available([safe, None], available)
}

fn first_available(preferred: [Option<u16>; 2], available: &[u16]) -> u16 {
    let is_available =
        |action: &u16| available.get(usize::from(*action)).is_some_and(|&code| code != 0);
    preferred
        .into_iter()
        .flatten()
        .chain(0..available.len() as u16)
        .find(is_available)
        .unwrap_or(NO_ACTION)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_then_plays_safe_then_takes_the_lowest() {
        let available = [0, 1, 0, 7, 1];
        assert_eq!(fallback_action(4, Some(3), &available), 4);
        assert_eq!(fallback_action(2, Some(3), &available), 3);
        assert_eq!(fallback_action(NO_ACTION, Some(2), &available), 1);
        assert_eq!(fallback_action(NO_ACTION, None, &available), 1);
        assert_eq!(fallback_action(0, Some(1), &[0, 0]), NO_ACTION);
        assert_eq!(guarded_action(4, Some(3), &available), 3);
        assert_eq!(guarded_action(4, Some(2), &available), 4);
        assert_eq!(guarded_action(4, None, &available), 4);
        assert_eq!(safe_action(Some(3), &available), 3);
        assert_eq!(safe_action(Some(0), &available), 1);
    }
}
