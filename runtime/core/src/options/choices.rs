//! Choices among what a mask leaves open.

use super::rules::bit;

/// The first of the largest numbers among those that are open; NaN never wins.
pub fn best(values: &[f32], is_open: impl Fn(usize) -> bool) -> Option<usize> {
    let open =
        values.iter().enumerate().filter(|(index, value)| is_open(*index) && !value.is_nan());
    open.reduce(|a, b| if b.1 > a.1 { b } else { a }).map(|(index, _)| index)
}

/// Of a mask the goals that were missed least often.
pub fn least_missed(mask: u32, missed: impl Fn(usize) -> usize) -> u32 {
    let open = || (0..u32::BITS as usize).filter(|goal| mask & bit(*goal) != 0);
    let least = open().map(&missed).min();
    let kept = open().filter(|goal| Some(missed(*goal)) == least);
    kept.fold(0, |set, goal| set | bit(goal))
}
