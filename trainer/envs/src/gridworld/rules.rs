//! One episode: its rules, what it has once, its steps, and what is left to chance.

use alloc::sync::Arc;
use alloc::vec::Vec;

use rand_core::Rng;

use super::ACTION_NAMES;
use super::map::{MAX_AGENTS, MAX_TREASURES, Map};
use crate::observation::members;
use crate::random::Random;

/// What an agent costs in a step, whatever it does.
const COST: f64 = 0.1;
/// What a treasure that counts earns.
const TREASURE: f64 = 10.0;

/// What all episodes have in common.
#[derive(Clone, Debug)]
pub struct Rules {
    /// The map.
    pub map: Map,
    /// The task of each tier; each tier is about as many treasures of its own.
    pub tiers: Vec<Task>,
    /// Chance per agent and step that its action is replaced by a random one.
    pub noise: f64,
    /// Steps after which an episode times out.
    pub episode_limit: u32,
}

impl Rules {
    pub(super) fn agents(&self) -> usize {
        self.map.starts.len()
    }

    /// Agents and pits.
    pub(super) fn counts(&self) -> (usize, usize) {
        (self.agents(), self.map.pits().len())
    }

    /// The task of a tier and its treasures, as bits.
    #[inline]
    pub(super) fn tier(&self, tier: u8) -> (Task, u8) {
        let (count, tier) = (self.map.treasures() / self.tiers.len(), usize::from(tier));
        (self.tiers[tier], (((1_u16 << count) - 1) << (tier * count)) as u8)
    }
}

/// What an instance has once.
#[derive(Clone, Debug)]
pub(super) struct Episode {
    pub(super) cells: [u16; MAX_AGENTS],
    pub(super) found: Found,
    /// Tiers that are finished.
    pub(super) tiers: u8,
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) pits: Vec<Pit>,
}

impl Episode {
    pub(super) fn start(&mut self, rules: &Rules) {
        self.cells[..rules.agents()].copy_from_slice(&rules.map.starts);
        (self.found, self.tiers, self.steps) = ([0; MAX_AGENTS], 0, 0);
        self.episode_return = 0.0;
        self.pits.fill(Pit::default());
    }

    pub(super) fn is_done(&self, rules: &Rules) -> bool {
        self.is_solved(rules) || self.steps >= rules.episode_limit
    }

    pub(super) fn is_solved(&self, rules: &Rules) -> bool {
        usize::from(self.tiers) == rules.tiers.len()
    }

    /// Plays one step with possible actions; returns what the team earns.
    #[inline]
    pub(super) fn play(&mut self, rules: &Rules, actions: &[u16], chance: &mut impl Chance) -> f64 {
        let map = &rules.map;
        let (task, asked) = rules.tier(self.tiers);
        let magnitude = task.magnitude();
        let before = self.cells;
        let agents = actions.len();
        self.steps += 1;
        for (agent, action) in actions.iter().enumerate() {
            let action = chance.taken(agent, *action as u8);
            self.cells[agent] = map.moved(self.cells[agent], action, self.tiers);
        }
        for agent in 0..agents {
            let look = map.seen_from(self.cells[agent]);
            if look.column == 4 && self.looked_at(look.pit, magnitude, chance).is_open {
                self.cells[agent] = map.starts[agent];
            }
        }
        self.share_cells(agents, &before, chance);
        let mut reward = 0.0;
        for agent in 0..agents {
            reward -= COST;
            let here = map.treasure_at(self.cells[agent]);
            if let Some(treasure) = here
                && task.counts(asked, &self.found, agent, treasure)
            {
                self.found[agent] |= 1 << treasure;
                reward += TREASURE;
            }
            // What is seen has to be known.
            let pit = map.seen_from(self.cells[agent]).pit;
            if usize::from(pit) < self.pits.len() {
                self.looked_at(pit, magnitude, chance);
            }
        }
        if task.is_done(asked, &self.found[..agents]) {
            self.settle(magnitude, chance);
            self.tiers += 1;
        }
        self.episode_return += reward;
        reward
    }

    /// A pit as it is after this step.
    #[inline]
    fn looked_at(&mut self, pit: u8, magnitude: f64, chance: &mut impl Chance) -> &Pit {
        let found = &mut self.pits[usize::from(pit)];
        found.catch_up(pit.into(), self.steps, magnitude, chance);
        found
    }

    /// Lets all pits make the steps that they are behind.
    pub(super) fn settle(&mut self, magnitude: f64, chance: &mut impl Chance) {
        for (pit, it) in self.pits.iter_mut().enumerate() {
            it.catch_up(pit, self.steps, magnitude, chance);
        }
    }

    /// Of two agents in one cell the one that came goes back; of two that came one by chance. Who is pushed back may
    /// meet another.
    #[inline]
    fn share_cells(&mut self, agents: usize, before: &[u16; MAX_AGENTS], chance: &mut impl Chance) {
        for first in 0..agents {
            for second in first + 1..agents {
                if self.cells[first] != self.cells[second] {
                    continue;
                }
                let stays = |agent: usize| self.cells[agent] == before[agent];
                let goes_back = if stays(first) {
                    second
                } else if stays(second) || chance.first_goes_back() {
                    first
                } else {
                    second
                };
                self.cells[goes_back] = before[goes_back];
            }
        }
    }
}

/// What each agent found: kinds of treasures as bits.
pub type Found = [u8; MAX_AGENTS];

/// When treasures count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Each treasure counts for whoever comes first.
    All,
    /// The treasure that is found first counts, once for each agent.
    Same,
    /// Each agent's own treasure counts.
    Own,
}

impl Task {
    /// Mean, and deviation, of what a step adds to the probability that a pit opens.
    pub(super) fn magnitude(self) -> f64 {
        if self == Self::All { 0.05 } else { 0.005 }
    }

    /// Whether a treasure among the `asked` ones counts for an agent that stands on it.
    #[inline]
    pub(super) fn counts(self, asked: u8, found: &Found, agent: usize, treasure: u8) -> bool {
        let bit = 1 << treasure;
        let known = union(found) & asked;
        asked & bit != 0
            && found[agent] & bit == 0
            && match self {
                Self::All => known & bit == 0,
                Self::Same => known == 0 || known & bit != 0,
                Self::Own => usize::from(treasure) == agent,
            }
    }

    /// Whether all that was asked for is found.
    pub(super) fn is_done(self, asked: u8, found: &[u8]) -> bool {
        match self {
            Self::All => found.iter().fold(0, |all, own| all | own) & asked == asked,
            Self::Same => found.iter().all(|own| own & asked != 0),
            Self::Own => found.iter().enumerate().all(|(agent, own)| own >> agent & 1 == 1),
        }
    }

    /// The treasures that an agent may go for.
    pub(super) fn wanted(self, asked: u8, found: &Found, agent: usize) -> u8 {
        let wants = |treasure: &u8| self.counts(asked, found, agent, *treasure);
        (0..MAX_TREASURES as u8).filter(wants).fold(0, |set, treasure| set | 1 << treasure)
    }
}

pub(super) fn union(found: &Found) -> u8 {
    found.iter().fold(0, |all, own| all | own)
}

/// Writes actions of a team that knows the map: in task [`All`](Task::All) agents share out what is left, else they go
/// for the first that counts. Who needs nothing goes on to another treasure, so as not to stand in the way.
pub(super) fn script(
    map: &Map,
    (task, asked): (Task, u8),
    found: &Found,
    cells: &[u16],
    actions: &mut [u16],
) {
    for (agent, (cell, action)) in cells.iter().zip(actions).enumerate() {
        let wanted = task.wanted(asked, found, agent);
        let turn = if task == Task::All { agent % wanted.count_ones().max(1) as usize } else { 0 };
        let goal = members(wanted.into()).nth(turn);
        let other = (found[agent].trailing_zeros() as usize + 1) % map.treasures();
        *action = map.way(usize::from(*cell), goal.unwrap_or(other)).into();
    }
}

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
    fn catch_up(&mut self, pit: usize, now: u32, magnitude: f64, chance: &mut impl Chance) {
        while self.ticks < now {
            let grown = chance.tick(pit, self.ticks, self.probability, magnitude);
            self.is_open = grown.is_none();
            self.probability = grown.map_or(0.0, |more| (self.probability + more).clamp(0.0, 1.0));
            self.ticks += 1;
        }
    }
}

/// Where all that is left to chance comes from: a generator, or a recording.
pub trait Chance {
    /// The action that an agent takes that was told to take one.
    fn taken(&mut self, agent: usize, action: u8) -> u8;

    /// Step `tick` of a pit that opens with this probability: what is added to it where it stays closed.
    fn tick(&mut self, pit: usize, tick: u32, probability: f64, magnitude: f64) -> Option<f64>;

    /// Whether the first of two agents that want the same cell goes back.
    fn first_goes_back(&mut self) -> bool;
}

/// Chance out of a generator.
pub(super) struct Drawn<'a> {
    pub(super) random: &'a mut Random,
    pub(super) noise: f64,
    pub(super) normals: &'a Normals,
}

impl Chance for Drawn<'_> {
    /// Both halves of one number: whether the action is replaced, and by which.
    #[inline]
    fn taken(&mut self, _: usize, action: u8) -> u8 {
        let number = self.random.next_u64();
        let is_replaced = ((number >> 32) as f64) < self.noise * (1_u64 << 32) as f64;
        let other = (((number & 0xffff_ffff) * ACTION_NAMES.len() as u64) >> 32) as u8;
        if is_replaced { other } else { action }
    }

    /// The high bits of one number say whether it opens, the low ones by how much the probability grows.
    #[inline]
    fn tick(&mut self, _: usize, _: u32, probability: f64, magnitude: f64) -> Option<f64> {
        const STEP: f64 = 1.0 / (1_u64 << 52) as f64;
        let number = self.random.next_u64();
        let opens = ((number >> 12) as f64) * STEP < probability;
        (!opens).then(|| magnitude + magnitude * self.normals.at(number as usize))
    }

    fn first_goes_back(&mut self) -> bool {
        self.random.next_u64() >> 63 == 0
    }
}

/// Standard normal numbers, all equally likely: the middles of so many slices of the same probability.
#[derive(Clone, Debug)]
pub struct Normals(Arc<[f32]>);

impl Normals {
    /// How many there are.
    pub const COUNT: usize = 1 << 12;

    /// Finds them by Newton's method, from the middle outwards: each begins where the one before it is.
    pub fn new() -> Self {
        let mut normals = [0.0_f32; Self::COUNT];
        let (half, mut value) = (Self::COUNT / 2, 0.0_f64);
        for place in 0..half {
            let above = (place as f64 + 0.5) / Self::COUNT as f64;
            for _ in 0..8 {
                let reached = 0.5 * libm::erf(value * core::f64::consts::FRAC_1_SQRT_2);
                let density = libm::exp(-0.5 * value * value) / libm::sqrt(core::f64::consts::TAU);
                value += (above - reached) / density;
            }
            normals[half + place] = value as f32;
            normals[half - 1 - place] = -value as f32;
        }
        Self(normals.to_vec().into())
    }

    /// One of them by a number, of which only the last bits count.
    #[inline]
    pub fn at(&self, number: usize) -> f64 {
        self.0[number & (Self::COUNT - 1)].into()
    }
}

impl Default for Normals {
    fn default() -> Self {
        Self::new()
    }
}
