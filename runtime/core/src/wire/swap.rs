//! When a team changes its bundle, and what makes it turn back.

/// The tick from which on a team decides by another bundle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SwapMoment {
    /// The next.
    #[default]
    NextTick,
    /// The first of the next episode.
    NextEpisode,
}

/// What makes a team turn back to the bundle that it had before, within one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TurnBack {
    /// An agent's policy has refused an observation, so that its fallback acts.
    pub on_fallback: bool,
    /// An answer was late, or did not come.
    pub on_late: bool,
}

/// The order to change a team's bundle, which fits the number of a [`ControlReq`](super::ControlReq).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SwapOrder {
    /// The generation in use, as whoever orders knows it: two orders at once cannot undo each other.
    pub generation: u16,
    /// From when on.
    pub moment: SwapMoment,
    /// What makes it turn back.
    pub back: TurnBack,
    /// For how many ticks after the change that holds.
    pub watched_ticks: u32,
}

const NEXT_EPISODE: u64 = 1 << 16;
const BACK_ON_FALLBACK: u64 = 1 << 17;
const BACK_ON_LATE: u64 = 1 << 18;

impl SwapOrder {
    /// As a number: 16 bits of generation, the flags, and in the upper half the ticks.
    pub fn to_number(self) -> u64 {
        let flags = [
            (self.moment == SwapMoment::NextEpisode, NEXT_EPISODE),
            (self.back.on_fallback, BACK_ON_FALLBACK),
            (self.back.on_late, BACK_ON_LATE),
        ];
        let flags =
            flags.into_iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag).sum::<u64>();
        u64::from(self.watched_ticks) << 32 | flags | u64::from(self.generation)
    }

    /// The order of this number; `None` where it says what only a later version knows.
    pub fn from_number(number: u64) -> Option<Self> {
        const KNOWN: u64 = NEXT_EPISODE | BACK_ON_FALLBACK | BACK_ON_LATE;
        let has = |flag: u64| number & flag != 0;
        let is_known = number & 0xFFFF_0000 & !KNOWN == 0;
        is_known.then_some(Self {
            // The lower bits, and the upper half.
            generation: number as u16,
            moment: if has(NEXT_EPISODE) { SwapMoment::NextEpisode } else { SwapMoment::NextTick },
            back: TurnBack { on_fallback: has(BACK_ON_FALLBACK), on_late: has(BACK_ON_LATE) },
            watched_ticks: (number >> 32) as u32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_is_a_number_and_comes_back() {
        let mut numbers = std::collections::BTreeSet::new();
        for flags in 0..8_u8 {
            let has = |bit: u8| flags >> bit & 1 == 1;
            let order = SwapOrder {
                generation: 0xFEDC,
                moment: if has(0) { SwapMoment::NextEpisode } else { SwapMoment::NextTick },
                back: TurnBack { on_fallback: has(1), on_late: has(2) },
                watched_ticks: u32::MAX - 1,
            };
            assert_eq!(SwapOrder::from_number(order.to_number()), Some(order));
            numbers.insert(order.to_number());
        }
        assert_eq!(numbers.len(), 8);
        // What only a later version says is not passed over.
        assert_eq!(SwapOrder::from_number(1 << 19), None);
    }
}
