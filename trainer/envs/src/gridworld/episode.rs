//! One episode: its rules, what it has once, and its steps.

use alloc::vec::Vec;

use super::chance::Chance;
use super::map::{MAX_AGENTS, Map};
use super::pits::Pit;
use super::tasks::{Found, Task};

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
    pub(super) fn looked_at(&mut self, pit: u8, magnitude: f64, chance: &mut impl Chance) -> &Pit {
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
