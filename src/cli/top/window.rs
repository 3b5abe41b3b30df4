//! What happened lately: counts by the second, of which only the newest seconds are kept.

use std::collections::VecDeque;

/// Seconds that every figure covers, the one that has begun included.
pub(super) const WINDOW_S: u64 = 10;
const SECOND_NS: u64 = 1_000_000_000;

/// Counts of some kind in each of the last seconds.
#[derive(Debug)]
pub(super) struct Window<T> {
    /// The oldest first, by the second of the domain's clock.
    seconds: VecDeque<(u64, T)>,
}

impl<T> Default for Window<T> {
    fn default() -> Self {
        Self { seconds: VecDeque::new() }
    }
}

impl<T: Default> Window<T> {
    /// The counts of this moment's second, to be added to.
    pub(super) fn at(&mut self, now_ns: u64) -> &mut T {
        let now = now_ns / SECOND_NS;
        self.seconds.retain(|(second, _)| *second > now.saturating_sub(WINDOW_S));
        // A clock that only goes forward has no later second than this one.
        if self.seconds.back().is_none_or(|(second, _)| *second != now) {
            self.seconds.push_back((now, T::default()));
        }
        let last = self.seconds.len() - 1;
        &mut self.seconds[last].1
    }

    /// The counts of all seconds that still matter.
    pub(super) fn recent(&self, now_ns: u64) -> impl Iterator<Item = &T> {
        let oldest = (now_ns / SECOND_NS).saturating_sub(WINDOW_S);
        let recent = self.seconds.iter().filter(move |(second, _)| *second > oldest);
        recent.map(|(_, counts)| counts)
    }
}

/// How many seconds such counts cover, of somebody who began to count then.
pub(super) fn covered_s(began_ns: u64, now_ns: u64) -> f64 {
    let first = (now_ns / SECOND_NS + 1).saturating_sub(WINDOW_S) * SECOND_NS;
    now_ns.saturating_sub(began_ns.max(first)) as f64 / SECOND_NS as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_older_than_the_window_is_forgotten() {
        let mut window = Window::<u64>::default();
        let at = |second: u64| second * SECOND_NS + 7;
        for second in 3..=30 {
            *window.at(at(second)) += second;
        }
        *window.at(at(30) + 5) += 100;
        let sum = |now| window.recent(now).sum::<u64>();
        assert_eq!(sum(at(30)), (21..=30).sum::<u64>() + 100);
        assert_eq!(sum(at(32)), (23..=30).sum::<u64>() + 100);
        assert_eq!(sum(at(40)), 0);
    }

    #[test]
    fn a_window_covers_what_was_heard_of_it() {
        let s = SECOND_NS;
        assert_eq!(covered_s(5 * s, 7 * s + s / 2), 2.5);
        // Nine whole seconds, and the half of the tenth.
        assert_eq!(covered_s(5 * s, 100 * s + s / 2), 9.5);
    }
}
