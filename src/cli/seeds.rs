//! Ranges of seeds, as `--seeds` takes them.

use std::ops::RangeInclusive;
use std::str::FromStr;

/// The most seeds that one command learns.
const MOST: u64 = 10_000;

/// Seeds from the first to the last, both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SeedRange {
    pub(crate) first: u64,
    pub(crate) last: u64,
}

impl SeedRange {
    /// This one alone.
    pub(crate) fn only(seed: u64) -> Self {
        Self { first: seed, last: seed }
    }

    /// All of them, in order.
    pub(crate) fn iter(self) -> RangeInclusive<u64> {
        self.first..=self.last
    }
}

impl FromStr for SeedRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("`{text}` is no range of seeds such as 1..5");
        let (first, last) = text.split_once("..").ok_or_else(expected)?;
        let number = |text: &str| text.parse::<u64>().map_err(|_| expected());
        let (first, last) = (number(first)?, number(last)?);
        match u64::checked_sub(last, first) {
            None => Err(expected()),
            Some(more) if more >= MOST => Err(format!("`{text}` are more than {MOST} seeds")),
            Some(_) => Ok(Self { first, last }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_includes_both_ends() {
        assert_eq!("1..5".parse(), Ok(SeedRange { first: 1, last: 5 }));
        assert_eq!("3..3".parse(), Ok(SeedRange { first: 3, last: 3 }));
        assert_eq!(SeedRange { first: 7, last: 9 }.iter().collect::<Vec<_>>(), [7, 8, 9]);
        assert!("1..10000".parse::<SeedRange>().is_ok());
        assert!("18446744073709551615..18446744073709551615".parse::<SeedRange>().is_ok());
        for wrong in ["5..1", "1", "a..b", "1..", "-1..2", "1..10001", "0..18446744073709551615"] {
            assert!(SeedRange::from_str(wrong).is_err(), "{wrong}");
        }
    }
}
