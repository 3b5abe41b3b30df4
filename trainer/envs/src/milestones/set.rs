//! Which milestones are in use.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::game::Game;
use crate::random::{below, generator};

/// Milestones of a game in their order; the last is the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MilestoneSet {
    /// As bits, by the numbers that the game gives them.
    used: u16,
}

impl MilestoneSet {
    /// All milestones up to a task.
    pub fn up_to<G: Game>(task: &str) -> Option<Self> {
        let last = number::<G>(task)?;
        Some(Self { used: (1 << (last + 1)) - 1 })
    }

    /// These milestones, the last of which in the order of the game is the task.
    ///
    /// # Errors
    /// The name that no milestone has; empty where there are no names.
    pub fn named<'a, G: Game>(names: impl Iterator<Item = &'a str>) -> Result<Self, &'a str> {
        let mut used = 0;
        for name in names {
            used |= 1 << number::<G>(name).ok_or(name)?;
        }
        if used == 0 { Err("") } else { Ok(Self { used }) }
    }

    /// The task and others of these milestones, so many in all, by a seed.
    ///
    /// # Errors
    /// There are fewer.
    pub fn drawn(self, count: usize, seed: u64) -> Result<Self, String> {
        let all = self.used.count_ones() as usize;
        if !(1..=all).contains(&count) {
            return Err(format!("{count} milestones, there are 1 to {all} for this task"));
        }
        let (mut random, mut drawn) = (generator(seed), self);
        while drawn.len() > count {
            let chosen = drawn.members().nth(below(&mut random, drawn.len() - 1));
            drawn.used &= !chosen.map_or(0, |milestone| 1 << milestone);
        }
        Ok(drawn)
    }

    /// As bits, by the numbers that the game gives them.
    pub fn bits(self) -> u16 {
        self.used
    }

    /// How many there are.
    #[expect(clippy::len_without_is_empty, reason = "a task is always there")]
    pub fn len(self) -> usize {
        self.used.count_ones() as usize
    }

    /// The number of the task.
    pub fn task(self) -> u8 {
        (15 - self.used.leading_zeros()) as u8
    }

    /// The place of a milestone among those in use.
    pub fn place(self, milestone: u8) -> Option<u8> {
        let below = self.used & ((1 << milestone) - 1);
        (self.used >> milestone & 1 == 1).then_some(below.count_ones() as u8)
    }

    /// Milestones as bits, by their places among those in use.
    pub fn places(self, milestones: u16) -> u32 {
        let members = self.members().enumerate();
        members.fold(0, |set, (place, milestone)| {
            set | u32::from(milestones >> milestone & 1) << place
        })
    }

    fn members(self) -> impl Iterator<Item = u8> {
        (0..16).filter(move |milestone| self.used >> milestone & 1 == 1)
    }

    /// Their names.
    pub fn names<G: Game>(self) -> Vec<&'static str> {
        self.members().map(|milestone| G::MILESTONES[usize::from(milestone)]).collect()
    }
}

fn number<G: Game>(name: &str) -> Option<u8> {
    G::MILESTONES.iter().position(|milestone| *milestone == name).map(|number| number as u8)
}
