//! Pits, which open for a step at a time.

use super::chance::Chance;

/// One pit. Nothing moves it but chance, so it stands still until somebody looks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pit {
    /// Probability that it opens in its next step.
    pub probability: f64,
    /// Steps that it has made.
    pub ticks: u32,
    /// Whether it opened in the last of them.
    pub is_open: bool,
}

impl Pit {
    /// Makes the steps that it is behind.
    #[inline]
    pub(super) fn catch_up(
        &mut self,
        pit: usize,
        now: u32,
        magnitude: f64,
        chance: &mut impl Chance,
    ) {
        while self.ticks < now {
            let grown = chance.tick(pit, self.ticks, self.probability, magnitude);
            self.is_open = grown.is_none();
            self.probability = grown.map_or(0.0, |more| (self.probability + more).clamp(0.0, 1.0));
            self.ticks += 1;
        }
    }
}
