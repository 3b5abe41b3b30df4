//! What a seed stands for.

use sortie_core::wire::{FrameFormat, FrameLayout};

use super::planted::Planted;
use super::random::Random;
use super::toy;

pub(crate) const MICROSECOND: u64 = 1_000;
pub(crate) const MILLISECOND: u64 = 1_000_000;

/// What may happen to messages; in every weather, processes are killed, stopped and leave, and time jumps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Weather {
    /// As shared memory: in order, whole, or overtaken by newer ones.
    Shared,
    /// As a radio with checksums: lost, late, doubled, out of order; damaged ones are noticed.
    Radio,
    /// Damaged ones are not noticed. Nobody can be held to what forged messages say, but nothing may
    /// panic, stand still, or do what cannot be done.
    Hostile,
}

#[derive(Clone, Debug)]
pub(crate) struct Setup {
    pub(crate) seed: u64,
    pub(crate) format: FrameFormat,
    pub(crate) agents: usize,
    /// The agents of each runner, as sets.
    pub(crate) runners: Vec<u64>,
    pub(crate) allocators: usize,
    pub(crate) period_ns: u64,
    pub(crate) patience_ns: u64,
    pub(crate) tick_interval_ns: u64,
    pub(crate) pipelined: bool,
    /// Agents and allocators have a fallback rule.
    pub(crate) heuristic: bool,
    pub(crate) decision_interval: u32,
    pub(crate) weather: Weather,
    /// Storms, each with a calm after it.
    pub(crate) storms: u32,
    pub(crate) planted: Option<Planted>,
    /// Which runners are on other hosts.
    pub(crate) away: Vec<bool>,
    /// Two processes offer themselves for each of them, and all that is said at home reaches both, as through a router.
    pub(crate) has_rivals: bool,
}

impl Setup {
    pub(crate) fn new(seed: u64, planted: Option<Planted>) -> Self {
        let mut random = Random::new(seed ^ 0x5e7u64.rotate_left(40));
        let agents = random.between(1, 5) as usize;
        let runners = random.between(1, agents as u64) as usize;
        let mut groups = vec![0; runners];
        for agent in 0..agents {
            groups[agent % runners] |= 1 << agent;
        }
        let weather = match random.below(10) {
            0..5 => Weather::Shared,
            5..8 => Weather::Radio,
            _ => Weather::Hostile,
        };
        let has_period = random.chance(500);
        let interval = random.between(3, 8) * MILLISECOND;
        // Lines have a checksum that nobody forges: what is hostile is at home.
        let has_hosts = weather != Weather::Hostile && random.chance(400);
        let mut away: Vec<bool> = (0..runners).map(|_| has_hosts && random.chance(600)).collect();
        let has_rivals = has_hosts && random.chance(500);
        let is_planted = planted.is_some_and(Planted::is_of_hosts);
        let weather = if is_planted { Weather::Shared } else { weather };
        if is_planted {
            away.fill(true);
        }
        if planted == Some(Planted::TwoSeats) {
            groups = vec![groups[0]; 2];
            away = vec![true; 2];
        }
        let layout = FrameLayout::new(toy::shape(agents)).expect("the toy is small");
        Self {
            seed,
            format: FrameFormat { schema: 0x50_7713, layout },
            agents,
            runners: groups,
            allocators: [2, 2, 3, 1][random.below(4) as usize],
            period_ns: if has_period { interval } else { 0 },
            patience_ns: random.between(10, 30) * MILLISECOND,
            tick_interval_ns: if has_period { 0 } else { interval },
            pipelined: random.chance(300),
            heuristic: random.chance(500),
            decision_interval: random.between(1, 5) as u32,
            weather,
            storms: 2,
            planted,
            away,
            has_rivals,
        }
    }

    pub(crate) fn has_hosts(&self) -> bool {
        self.away.contains(&true)
    }

    /// Whether a runner on another host acts for this agent.
    pub(crate) fn is_away(&self, agent: usize) -> bool {
        let mut runners = self.runners.iter().zip(&self.away);
        runners.any(|(agents, is_away)| *is_away && agents >> agent & 1 == 1)
    }

    /// After so long without any disturbance, everything works as if there had never been one. A line is for a second its runner's
    /// that has died, and a runner waits as long before it looks for another end of its team.
    pub(crate) fn recovery_ns(&self) -> u64 {
        if self.has_hosts() { 1_700 * MILLISECOND } else { 300 * MILLISECOND }
    }
}
