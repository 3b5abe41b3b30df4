//! Until when a tick waits.

/// With a period, agents act without this tick's allocation after this share of it.
const ALLOCATE_PERCENT: u64 = 35;
/// With a period, the world stops waiting for actions after this share of it.
const ACT_PERCENT: u64 = 80;

/// How long the world waits for actions after a frame; `None` = without limit.
pub(super) fn act_within(period_ns: u64, patience_ns: u64) -> Option<u64> {
    match (period_ns, patience_ns) {
        (0, 0) => None,
        (0, patience) => Some(patience),
        (period, _) => Some(percent(period, ACT_PERCENT)),
    }
}

/// Until when agents wait for the allocation of a frame of `t_ns`, whose actions count until
/// `deadline_ns` (0 = for ever): a share of the period, or half of the patience.
pub(super) fn allocate_by(t_ns: u64, deadline_ns: u64, period_ns: u64) -> u64 {
    let wait = match (deadline_ns, period_ns) {
        (0, _) => return u64::MAX,
        (deadline, 0) => deadline.saturating_sub(t_ns) / 2,
        (_, period) => percent(period, ALLOCATE_PERCENT),
    };
    t_ns.saturating_add(wait).min(deadline_ns)
}

fn percent(of: u64, percent: u64) -> u64 {
    of / 100 * percent + of % 100 * percent / 100
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_for_shares_of_the_period_or_of_the_patience() {
        assert_eq!(act_within(0, 0), None);
        assert_eq!(act_within(0, 2_000), Some(2_000));
        assert_eq!(act_within(1_000_000, 2_000), Some(800_000));
        assert_eq!(allocate_by(5, 0, 0), u64::MAX);
        assert_eq!(allocate_by(5, 0, 1_000), u64::MAX);
        assert_eq!(allocate_by(1_000, 3_000, 0), 2_000);
        assert_eq!(allocate_by(1_000, 1_800, 1_000), 1_350);
        assert_eq!(allocate_by(1_000, 900, 0), 900);
        assert_eq!(percent(u64::MAX, 100), u64::MAX);
    }
}
