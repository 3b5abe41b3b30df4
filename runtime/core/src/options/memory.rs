//! What an agent that runs options remembers, as numbers that a caller keeps for it.

use super::rules::OptionRules;

/// Numbers before the lists.
const HEAD: usize = 4;
/// Whole numbers up to here are exact.
const TICKS: u32 = 1 << 24;

/// The numbers by what they are; all are zero where an episode begins.
pub(super) struct Memory<'m> {
    /// The goal's number and one more, steps gone for it, ticks of the episode, views in the list.
    head: &'m mut [f32],
    carried: &'m mut [f32],
    missed: &'m mut [f32],
    views: &'m mut [f32],
}

/// What a running option is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pursuit {
    /// The milestone that the agent goes for.
    pub goal: usize,
    /// Steps that it has gone for it; 1 where the option began with the last decision.
    pub steps: usize,
}

impl Pursuit {
    /// What a memory says; none where the episode has not begun.
    pub fn of(memory: &[f32]) -> Option<Self> {
        let goal = (*memory.first()? as usize).checked_sub(1)?;
        Some(Self { goal, steps: *memory.get(1)? as usize })
    }
}

/// Numbers of a memory under these rules.
pub(super) fn floats(rules: &OptionRules) -> usize {
    HEAD + rules.picture.counts + rules.milestones().len() + usize::from(rules.steps)
}

impl<'m> Memory<'m> {
    /// None where there are not as many numbers as the rules ask for.
    pub(super) fn of(memory: &'m mut [f32], rules: &OptionRules) -> Option<Self> {
        if memory.len() != floats(rules) {
            return None;
        }
        let (head, rest) = memory.split_at_mut_checked(HEAD)?;
        let (carried, rest) = rest.split_at_mut_checked(rules.picture.counts)?;
        let (missed, views) = rest.split_at_mut_checked(rules.milestones().len())?;
        Some(Self { head, carried, missed, views })
    }

    fn number(&self, place: usize) -> usize {
        self.head.get(place).map_or(0, |number| *number as usize)
    }

    fn set(&mut self, place: usize, number: usize) {
        self.head.get_mut(place).into_iter().for_each(|to| *to = number as f32);
    }

    /// The running option; none where the episode begins.
    pub(super) fn pursuit(&self) -> Option<Pursuit> {
        Pursuit::of(self.head)
    }

    /// Ticks of the episode so far.
    pub(super) fn ticks(&self) -> u32 {
        self.number(2) as u32
    }

    /// What was carried in the tick before.
    pub(super) fn carried(&self) -> &[f32] {
        self.carried
    }

    /// How often each goal was missed since the last milestone.
    pub(super) fn missed(&self, goal: usize) -> usize {
        self.missed.get(goal).map_or(0, |count| *count as usize)
    }

    /// How often a view was met in the option before.
    pub(super) fn meetings(&self, view: u32) -> usize {
        let met = self.views.iter().take(self.number(3));
        met.filter(|other| **other as u32 == view).count()
    }

    /// Notes what is carried now, and that a tick is over.
    pub(super) fn pass(&mut self, carried: &[f32]) {
        self.carried.iter_mut().zip(carried).for_each(|(to, from)| *to = *from);
        let ticks = self.ticks().saturating_add(1) % TICKS;
        self.set(2, ticks as usize);
        let steps = self.number(1).saturating_add(1);
        self.set(1, steps);
    }

    /// Begins an option.
    pub(super) fn begin(&mut self, goal: usize) {
        self.set(0, goal.saturating_add(1));
        self.set(1, 0);
        self.set(3, 0);
    }

    /// Notes that a goal was missed, or that none counts as missed any more.
    pub(super) fn miss(&mut self, goal: Option<usize>) {
        match goal {
            None => self.missed.fill(0.0),
            Some(goal) => self.missed.get_mut(goal).into_iter().for_each(|count| *count += 1.0),
        }
    }

    /// Notes a view of the option.
    pub(super) fn meet(&mut self, view: u32) {
        let place = self.number(3);
        if let Some(to) = self.views.get_mut(place) {
            *to = view as f32;
            self.set(3, place.saturating_add(1));
        }
    }
}
