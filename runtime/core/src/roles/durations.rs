//! How long a process takes, in the histograms of its status.

/// Shortest duration that buckets tell apart.
const UNIT_NS: u64 = 16;

/// Counts of durations since the process's start: bucket k holds those of [2^k, 2^(k+1)) times 16 ns, the
/// first one shorter ones as well, the last one longer ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Durations([u32; 32]);

impl Durations {
    pub(super) fn note(&mut self, duration_ns: u64) {
        let bucket = (duration_ns / UNIT_NS).checked_ilog2().unwrap_or(0) as usize;
        let last = self.0.len() - 1;
        if let Some(count) = self.0.get_mut(bucket.min(last)) {
            *count = count.saturating_add(1);
        }
    }

    pub(super) fn to_wire(self) -> [u32; 32] {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_double() {
        let mut durations = Durations::default();
        for ns in [0, 15, 16, 31, 32, 63, 64, 16 << 31, u64::MAX] {
            durations.note(ns);
        }
        let counts = durations.to_wire();
        assert_eq!((&counts[..4], counts[31]), (&[4, 2, 1, 0][..], 2));
    }
}
