//! Pauses between decisions.

/// When the last decision began.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pause {
    last: u64,
}

impl Pause {
    /// A decision begins. Returns whether the last one began so long ago that other work may have pushed what it read
    /// out of the caches; always false where no cheap clock tells.
    #[inline]
    pub(crate) fn end(&mut self) -> bool {
        self.end_at(ticks())
    }

    fn end_at(&mut self, now: u64) -> bool {
        /// A tenth of a millisecond: the clock ticks two to five times in a nanosecond.
        const LONG: u64 = 250_000;
        let passed = now.wrapping_sub(self.last);
        self.last = now;
        passed > LONG
    }
}

#[inline(always)]
fn ticks() -> u64 {
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    return super::x86::ticks();
    #[cfg(not(all(feature = "std", target_arch = "x86_64")))]
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_long_pause_counts() {
        let mut pause = Pause::default();
        let ended = [1_000_000, 1_000_001, 1_250_001, 1_500_002].map(|now| pause.end_at(now));
        assert_eq!(ended, [true, false, false, true]);
        // The clock begins anew.
        assert!(pause.end_at(0));
    }
}
