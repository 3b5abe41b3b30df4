//! The allocator that points: subtasks are encoded once, then one agent after the other points at one (the attention model of
//! Kool et al. 2019).
//!
//! Two plans of whatever network: the encoder makes tables of what stays as it is of subtasks in an episode, and is asked again
//! only where that has changed; the decoder scores subtasks for one agent. Who can be given what is not theirs to say: any
//! state gets a feasible allocation or a refusal.

#[cfg(feature = "alloc")]
mod memory;
mod round;

#[cfg(feature = "alloc")]
pub use memory::PointingMemory;
pub use round::{Round, TaskBits};

use super::members;
use crate::allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use crate::entity_mask::EntityMask;
use crate::limits;
use crate::math::all_finite;
use crate::plan::{Network, Plan, PlanError};
use crate::policy::DecideError;

/// What agents can be given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PointingRules {
    /// Bit t set where one agent alone can be given subtask t, and only while an action that heads for it is available.
    pub exclusive: u32,
    /// The action that heads for the first subtask; each of the next heads for the next one.
    pub first_action: u16,
}

/// Sizes of the two networks.
///
/// The encoder takes rows `[T, fixed]` of subtasks and which of them there are `[T]`, and gives tables `[T, table]` and three
/// more tensors. The decoder takes a [description](Round::describe) `[3 d + 1 + fixed]`, what the table of the subtask that the
/// agent had last holds for it `[own]` (the last columns), of the other agents [descriptions](Round::describe_other)
/// `[A - 1, d + 1]` and what the tables of theirs hold for them `[A - 1, given]` (the first columns), which subtasks are left and
/// which of the other agents there are `[T + A - 1]`, and the three tensors, and gives scores `[T]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sizes {
    tasks: usize,
    fixed: usize,
    columns: usize,
    own: usize,
    others: usize,
    given: usize,
    table: usize,
    looked_at: [usize; 3],
}

impl Sizes {
    /// None where the plans are no such networks.
    fn of(encoder: &Plan<'_>, decoder: &Plan<'_>) -> Option<Self> {
        let [subtasks, tasks] = all(encoder.inputs())?;
        let [tables, made @ ..]: [usize; 4] = all(encoder.outputs())?;
        let [context, own, rows, given, seen, looked_at @ ..]: [usize; 8] = all(decoder.inputs())?;
        let others = seen.checked_sub(tasks)?;
        let [scores] = all(decoder.outputs())?;
        let sizes = Self {
            tasks,
            fixed: subtasks.checked_div(tasks)?,
            columns: rows.checked_div(others)?.checked_sub(1)?,
            own,
            others,
            given: given.checked_div(others)?,
            table: tables.checked_div(tasks)?,
            looked_at,
        };
        let fits = [sizes.context(), tasks] == [context, scores]
            && made == looked_at
            && sizes.fixed <= sizes.columns
            && sizes.given <= sizes.table
            && sizes.own <= sizes.table
            && tasks <= limits::TASKS
            && others < limits::AGENTS;
        fits.then_some(sizes)
    }

    fn context(&self) -> usize {
        Round::context(self.columns, self.fixed)
    }

    /// Of the parts of the [`Memory`], in their order.
    fn parts(&self) -> [usize; 12] {
        let Self { tasks, fixed, columns, own, others, given, table, .. } = *self;
        let (context, [keys, values, points]) = (self.context(), self.looked_at);
        [
            tasks * fixed,
            tasks,
            tasks * table,
            keys,
            values,
            points,
            context,
            own,
            others * (columns + 1),
            others * given,
            tasks + others,
            tasks,
        ]
    }
}

/// As many sizes as are wanted, and no more.
fn all<const COUNT: usize>(sizes: impl Iterator<Item = usize>) -> Option<[usize; COUNT]> {
    let mut found = heapless::Vec::<_, COUNT>::new();
    for size in sizes {
        found.push(size).ok()?;
    }
    found.into_array().ok()
}

/// Inputs and outputs of the networks.
#[derive(Debug)]
struct Memory<'a> {
    subtasks: &'a mut [f32],
    present: &'a mut [f32],
    tables: &'a mut [f32],
    keys: &'a mut [f32],
    values: &'a mut [f32],
    points: &'a mut [f32],
    context: &'a mut [f32],
    own: &'a mut [f32],
    others: &'a mut [f32],
    given: &'a mut [f32],
    seen: &'a mut [f32],
    scores: &'a mut [f32],
}

impl<'a> Memory<'a> {
    fn new(sizes: &Sizes, memory: &'a mut [f32]) -> Option<Self> {
        let mut rest = memory;
        let parts = sizes.parts().map(|size| {
            let (part, behind) = core::mem::take(&mut rest).split_at_mut_checked(size)?;
            rest = behind;
            Some(part)
        });
        let [subtasks, present, tables, keys, values, points, rest @ ..] = parts;
        let [context, own, others, given, seen, scores] = rest;
        Some(Self {
            subtasks: subtasks?,
            present: present?,
            tables: tables?,
            keys: keys?,
            values: values?,
            points: points?,
            context: context?,
            own: own?,
            others: others?,
            given: given?,
            seen: seen?,
            scores: scores?,
        })
    }
}

/// Allocates by a network that points.
#[derive(Debug)]
pub struct PointingAllocator<'a> {
    encoder: Plan<'a>,
    decoder: Plan<'a>,
    rules: PointingRules,
    sizes: Sizes,
    arena: &'a mut [u8],
    memory: Memory<'a>,
    /// The tables are those of the subtasks.
    encoded: bool,
}

impl<'a> PointingAllocator<'a> {
    /// Binds the plans of encoder and decoder to an arena that is large enough for either, and to memory, see
    /// [`Self::memory_floats`].
    ///
    /// # Errors
    /// The plans are other networks', or the arena or the memory is too small.
    pub fn new(
        [encoder, decoder]: [Plan<'a>; 2],
        rules: PointingRules,
        arena: &'a mut [u8],
        memory: &'a mut [f32],
    ) -> Result<Self, PlanError> {
        for plan in [&encoder, &decoder] {
            plan.check_network(Network::Policy)?;
            plan.check_arena(arena)?;
        }
        let sizes = Sizes::of(&encoder, &decoder).ok_or(PlanError::WrongNetwork)?;
        let [need, got] =
            [sizes.parts().iter().sum(), memory.len()].map(|floats: usize| 4 * floats);
        // Rows that nobody looks at have to be numbers as well.
        memory.fill(0.0);
        let memory = Memory::new(&sizes, memory).ok_or(PlanError::ArenaTooSmall { need, got })?;
        Ok(Self { encoder, decoder, rules, sizes, arena, memory, encoded: false })
    }

    /// Floats of memory; 0 where the plans are other networks'.
    pub fn memory_floats([encoder, decoder]: [&Plan<'_>; 2]) -> usize {
        Sizes::of(encoder, decoder).map_or(0, |sizes| sizes.parts().iter().sum())
    }

    /// Agents A and subtasks T that there is room for.
    pub fn most(&self) -> [usize; 2] {
        [self.sizes.others + 1, self.sizes.tasks]
    }

    /// Takes the rows of subtasks from a state, of each that of its first thing.
    fn look(&mut self, state: &AllocationState<'_>) {
        let Self { sizes, memory, encoded, .. } = self;
        let mut known = 0;
        for entity in state.present.iter().filter(|entity| *entity >= state.agents) {
            let tasks = state.entity_task.get(entity).copied().unwrap_or(0);
            for task in members(tasks & !known) {
                let from = row(state.rows, entity, state.stride).iter().copied();
                let to = row_mut(memory.subtasks, task, sizes.fixed);
                *encoded &= !replaced(to, from);
            }
            known |= tasks;
        }
        for task in 0..sizes.tasks {
            let is_known = known >> task & 1;
            let to = row_mut(memory.present, task, 1);
            *encoded &= !replaced(to, [is_known as f32].into_iter());
            if is_known == 0 {
                row_mut(memory.subtasks, task, sizes.fixed).fill(0.0);
            }
        }
    }

    /// Fills the tables, unless they are those of the subtasks.
    fn encode(&mut self) -> Result<(), DecideError> {
        if !self.encoded {
            let Memory { subtasks, present, tables, keys, values, points, .. } = &mut self.memory;
            let outputs: &mut [&mut [f32]] = &mut [tables, keys, values, points];
            self.encoder.respond(self.arena, &[subtasks, present], &mut [], outputs)?;
            self.encoded = true;
        }
        Ok(())
    }

    /// The subtask that the decoder scores highest among some for an agent, the first of several.
    fn point(&mut self, round: Round<'_>, agent: usize, options: u32) -> Result<u8, DecideError> {
        let Self { sizes, memory, .. } = self;
        let left = round.left();
        let subtasks = &*memory.subtasks;
        let rows = members(left).map(|task| row(subtasks, task, sizes.fixed));
        round.describe(agent, rows, memory.context);
        let table = |agent| row(memory.tables, round.subtask_of(agent).into(), sizes.table).iter();
        replace(memory.own, table(agent).skip(sizes.table - sizes.own));
        memory.seen.fill(0.0);
        for task in members(left) {
            row_mut(memory.seen, task, 1).fill(1.0);
        }
        for (place, other) in round.others(agent).enumerate() {
            row_mut(memory.seen, sizes.tasks + place, 1).fill(1.0);
            let described = row_mut(memory.others, place, sizes.columns + 1);
            round.describe_other(agent, other, described);
            replace(row_mut(memory.given, place, sizes.given), table(other));
        }
        let Memory { context, own, others, given, seen, keys, values, points, scores, .. } = memory;
        let inputs: [&[f32]; 8] = [context, own, others, given, seen, keys, values, points];
        self.decoder.respond(self.arena, &inputs, &mut [], &mut [&mut *scores])?;
        let mut best = (options.trailing_zeros() as u8, f32::NEG_INFINITY);
        for task in members(options) {
            let score = scores.get(task).copied().unwrap_or(f32::NEG_INFINITY);
            if score > best.1 {
                best = (task as u8, score);
            }
        }
        Ok(best.0)
    }

    /// The open subtasks that an agent can be given.
    fn offer(&self, state: &AllocationState<'_>, agent: usize) -> u32 {
        let PointingRules { exclusive, first_action } = self.rules;
        if !state.present.contains(agent) {
            return 0;
        }
        let actions = state.available.len().checked_div(state.agents).unwrap_or(0);
        let heading = row(state.available, agent, actions).iter().skip(first_action.into());
        let within_reach = heading.zip(0..limits::TASKS).filter(|(available, _)| **available != 0);
        let within_reach = within_reach.fold(0, |tasks, (_, task)| tasks | 1 << task);
        state.open_tasks & (within_reach | !exclusive)
    }

    fn allocate_all(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), DecideError> {
        let mut offers = [0; limits::AGENTS];
        for (agent, offer) in offers.iter_mut().enumerate().take(state.agents) {
            *offer = self.offer(state, agent);
        }
        let mut before = [UNASSIGNED; limits::AGENTS];
        for (before, tasks) in before.iter_mut().zip(state.entity_task).take(state.agents) {
            *before = members(*tasks).next().map_or(UNASSIGNED, |task| task as u8);
        }
        self.look(state);
        self.encode()?;
        allocation.fill(UNASSIGNED);
        for agent in 0..allocation.len() {
            let round = Round {
                before: before.get(..state.agents).unwrap_or_default(),
                rows: state.rows,
                stride: state.stride,
                columns: self.sizes.columns,
                offers: offers.get(..state.agents).unwrap_or_default(),
                exclusive: self.rules.exclusive,
                open: state.open_tasks,
                allocation,
            };
            let options = round.options(agent);
            let given = match options.count_ones() {
                0 => UNASSIGNED,
                1 => options.trailing_zeros() as u8,
                _ => self.point(round, agent, options)?,
            };
            if let Some(task) = allocation.get_mut(agent) {
                *task = given;
            }
        }
        Ok(())
    }
}

impl Allocator for PointingAllocator<'_> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let [agents, tasks] = self.most();
        if state.agents > agents || state.tasks > tasks {
            return Err(AllocateError::TooLarge);
        }
        // What one agent alone can be given is offered by its actions: somebody has to tell which are available.
        let PointingRules { exclusive, first_action } = self.rules;
        let actions = if exclusive == 0 { 0 } else { usize::from(first_action) + state.tasks };
        if state.stride < self.sizes.columns || state.available.len() < state.agents * actions {
            return Err(AllocateError::BadLength);
        }
        let present = state.present.and(&EntityMask::first(state.entity_task.len()));
        let state = &AllocationState { present, ..*state };
        let mut rows = present.iter().map(|entity| row(state.rows, entity, state.stride));
        if !rows.all(|row| all_finite(row.get(..self.sizes.columns).unwrap_or_default())) {
            return Err(AllocateError::NonFinite);
        }
        self.allocate_all(state, allocation).map_err(|error| match error {
            DecideError::NonFinite => AllocateError::NonFinite,
            _ => AllocateError::BadLength,
        })
    }
}

/// Row `index` of `columns` items; empty where there is none.
fn row<T>(items: &[T], index: usize, columns: usize) -> &[T] {
    let start = index.saturating_mul(columns);
    items.get(start..start.saturating_add(columns)).unwrap_or_default()
}

fn row_mut(items: &mut [f32], index: usize, columns: usize) -> &mut [f32] {
    let start = index.saturating_mul(columns);
    items.get_mut(start..start.saturating_add(columns)).unwrap_or_default()
}

/// Copies numbers, zeros behind them.
fn replace<'n>(to: &mut [f32], from: impl Iterator<Item = &'n f32>) {
    let from = from.copied().chain(core::iter::repeat(0.0));
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
}

/// Copies numbers, and tells whether any of them differs from what stood there.
fn replaced(to: &mut [f32], from: impl Iterator<Item = f32>) -> bool {
    let mut differs = false;
    for (to, from) in to.iter_mut().zip(from) {
        differs |= to.to_bits() != from.to_bits();
        *to = from;
    }
    differs
}
