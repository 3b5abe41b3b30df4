//! One agent after the other is given a subtask: what it can still be given, and what it knows of all others by then.

use core::ops::{BitAnd, BitOr, Not};

use crate::allocator::UNASSIGNED;

/// What one more subtask that is left adds to their sum, so that it is about 1.
const SUM_SCALE: f32 = 0.2;

/// Subtasks as bits: 32 of them in messages and plans, more where they are learned.
pub trait TaskBits:
    Copy + PartialEq + Default + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self>
{
    /// A subtask as a set; none where nobody was given it, or there is no room for it.
    fn one(task: u8) -> Self;
}

impl TaskBits for u32 {
    fn one(task: u8) -> Self {
        1_u32.checked_shl(task.into()).unwrap_or(0)
    }
}

impl TaskBits for u128 {
    fn one(task: u8) -> Self {
        1_u128.checked_shl(task.into()).unwrap_or(0)
    }
}

/// A team that is being allocated, in the order of its agents' numbers.
#[derive(Clone, Copy, Debug)]
pub struct Round<'a, S = u32> {
    /// The agents' rows `[A, stride]`, of which the first `columns` count.
    pub rows: &'a [f32],
    /// Columns from a row to the next.
    pub stride: usize,
    /// Columns d of a row that count.
    pub columns: usize,
    /// `[A]`: the subtasks that each agent can be given, as bits; none where it does not act.
    pub offers: &'a [S],
    /// Subtasks that one agent alone can be given.
    pub exclusive: S,
    /// Subtasks that are not finished.
    pub open: S,
    /// `[A]`: what agents had before; [`UNASSIGNED`] where that is nothing.
    pub before: &'a [u8],
    /// `[A]`: what they were given now; [`UNASSIGNED`] where that is nothing yet.
    pub allocation: &'a [u8],
}

impl Round<'_> {
    /// Columns of a [description](Self::describe) where agents have so many columns, and subtasks so many.
    pub const fn context(columns: usize, subtask: usize) -> usize {
        3 * columns + 1 + subtask
    }
}

impl<'a, S: TaskBits> Round<'a, S> {
    /// Subtasks that are not finished, but for those that somebody was given alone.
    pub fn left(&self) -> S {
        let none = S::default();
        let given = self.allocation.iter().fold(none, |given, task| given | S::one(*task));
        self.open & !(given & self.exclusive)
    }

    /// What an agent can still be given. Of agents that are alike the first ones are given what one alone can have: whoever
    /// comes after one that was not leaves it, which loses no allocation but the same with names exchanged.
    pub fn options(&self, agent: usize) -> S {
        let none = S::default();
        let options = self.offer(agent) & self.left();
        let shared = options & !self.exclusive;
        let mut earlier = self.allocation.iter().take(agent).enumerate();
        let has_twin = earlier.any(|(twin, task)| {
            S::one(*task) & !self.exclusive != none && self.row(twin) == self.row(agent)
        });
        if has_twin && shared != none { shared } else { options }
    }

    /// The agents that act, but for one.
    pub fn others(self, agent: usize) -> impl Iterator<Item = usize> + Clone + 'a {
        (0..self.offers.len())
            .filter(move |other| *other != agent && self.offer(*other) != S::default())
    }

    /// What an agent was given last, now or before.
    pub fn subtask_of(&self, agent: usize) -> u8 {
        let of = |allocation: &[u8]| allocation.get(agent).copied().unwrap_or(UNASSIGNED);
        let now = of(self.allocation);
        if now == UNASSIGNED { of(self.before) } else { now }
    }

    /// An agent's row; empty where there is none.
    pub fn row(&self, agent: usize) -> &'a [f32] {
        let start = agent.saturating_mul(self.stride);
        self.rows.get(start..start.saturating_add(self.columns)).unwrap_or_default()
    }

    /// Writes what is known of another agent `[d + 1]`: its row, and whether it has chosen already.
    pub fn describe_other(&self, agent: usize, other: usize, to: &mut [f32]) {
        let Some((chosen, row)) = to.split_last_mut() else { return };
        row.iter_mut().zip(self.row(other)).for_each(|(to, value)| *to = *value);
        *chosen = if other < agent { 1.0 } else { 0.0 };
    }

    /// Writes what is known in a decision about an agent: its row, means of those that
    /// chose before it and of those that choose after it, which share these are, and the sum of the rows that are left.
    pub fn describe<'r>(
        self,
        agent: usize,
        left: impl Iterator<Item = &'r [f32]>,
        context: &mut [f32],
    ) {
        context.fill(0.0);
        let mut rest = context;
        let mut part = || {
            let (part, behind) = core::mem::take(&mut rest).split_at_mut_checked(self.columns)?;
            rest = behind;
            Some(part)
        };
        let (before, after) = (
            self.others(agent).take_while(move |other| *other < agent),
            self.others(agent).skip_while(move |other| *other < agent),
        );
        if let Some(own) = part() {
            own.iter_mut().zip(self.row(agent)).for_each(|(to, value)| *to = *value);
        }
        let _ = part().map(|mean| self.write_mean(before, mean));
        let _ = part().map(|mean| self.write_mean(after.clone(), mean));
        let Some((share, sum)) = rest.split_first_mut() else { return };
        *share = after.count() as f32 / self.offers.len().max(1) as f32;
        for row in left {
            sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += SUM_SCALE * value);
        }
    }

    fn write_mean(&self, agents: impl Iterator<Item = usize> + Clone, mean: &mut [f32]) {
        let share = 1.0 / agents.clone().count().max(1) as f32;
        for agent in agents {
            mean.iter_mut().zip(self.row(agent)).for_each(|(mean, value)| *mean += share * value);
        }
    }

    fn offer(&self, agent: usize) -> S {
        self.offers.get(agent).copied().unwrap_or_default()
    }
}
