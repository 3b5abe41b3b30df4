//! A team whose every number tells which frame it was made from, so that whatever is torn, mixed up or out of date shows, and
//! the checks that everything that arrives is whole, and what it says that it is.

use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

use sortie_core::roles::TickReport;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameMut};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, Observation,
    Policy, Shape, StepOutcome, UNASSIGNED, UnavailableAction, World,
};
use sortie_ipc::DomainContract;

use super::StormReport;

/// Agents of the storm's team.
pub(super) const AGENTS: usize = 4;
const TASKS: usize = 3;
/// As much as a frame of a real team carries.
const SHAPE: Shape = Shape { agents: AGENTS, entities: 12, tasks: TASKS, actions: 5, features: 64 };
/// Steps of an episode.
const EPISODE: u32 = 500;
/// Numbers below this are exact as `f32`, and so told apart.
const NUMBERS: u32 = 1 << 24;

/// The contract of the storm's domain.
pub(super) fn contract() -> DomainContract {
    DomainContract {
        hash: 0x0073_746f_726d_0001,
        decision_interval: 4,
        subtasks: true,
        safe_action: Some(0),
        ..DomainContract::default()
    }
}

/// Every feature of a frame is the frame's number.
#[derive(Default)]
pub(super) struct StormWorld {
    step: u32,
    /// Shared with the onlooker, who compares.
    pub(super) number: Rc<Cell<u32>>,
}

impl StormWorld {
    fn next(&self) {
        self.number.set((self.number.get() + 1) % NUMBERS);
    }
}

impl World for StormWorld {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {
        self.step = 0;
        self.next();
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let all = EntityMask::first(SHAPE.entities);
        frame.set_present(&all);
        frame.set_open_tasks((1 << TASKS) - 1);
        for entity in 0..SHAPE.entities {
            frame.row_mut(entity).fill(self.number.get() as f32);
        }
        for agent in 0..AGENTS {
            frame.set_observable(agent, &all);
            frame.available_mut(agent).fill(1);
        }
    }

    fn step(&mut self, _actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        self.step += 1;
        self.next();
        Ok(StepOutcome { episode_ended: self.step == EPISODE, tasks_changed: false })
    }
}

/// The number of a frame, if all its features agree.
fn number(rows: &[f32], stride: usize) -> Option<f32> {
    let first = *rows.first()?;
    let mut features = rows.chunks_exact(stride).filter_map(|row| row.get(..SHAPE.features));
    features.all(|row| row.iter().all(|&feature| feature == first)).then_some(first)
}

/// Decides on nothing but the frame's number, which it tells as utility; refuses a torn frame.
pub(super) struct StormPolicy;

impl Policy for StormPolicy {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let number = number(observation.rows, observation.stride).ok_or(DecideError::NonFinite)?;
        utilities.fill(number);
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let number = number(observation.rows, observation.stride).ok_or(DecideError::NonFinite)?;
        Ok(Decision { action: number as u16 % SHAPE.actions as u16, utility: number })
    }
}

/// The subtask that a frame's number gives an agent.
fn task_of(number: u32, agent: usize) -> u8 {
    ((number as usize + agent) % TASKS) as u8
}

/// A frame that was published.
#[derive(Clone, Copy)]
struct Published {
    tick: u64,
    number: u32,
    /// Bit a: it says that nobody acts for agent a.
    absent: u64,
}

impl Published {
    /// The subtask that an allocation for this frame gives an agent.
    fn task_of(&self, agent: usize) -> u8 {
        let is_absent = self.absent >> agent & 1 == 1;
        if is_absent { UNASSIGNED } else { task_of(self.number, agent) }
    }
}

/// Allocates by the frame's number; refuses a torn frame.
pub(super) struct StormAllocator;

impl Allocator for StormAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        let number = number(state.rows, state.stride).ok_or(AllocateError::Infeasible)?;
        for (agent, task) in allocation.iter_mut().enumerate() {
            *task = task_of(number as u32, agent);
        }
        Ok(())
    }
}

/// Frames and allocations that are remembered.
const MEMORY: usize = 256;

/// What was published, against which everything is held.
pub(super) struct Checks {
    number: Rc<Cell<u32>>,
    /// The number of the frame that the next report is about.
    current: u32,
    frames: VecDeque<Published>,
    /// Newest allocations, not yet compared with their frames, and compared.
    pending: Vec<AllocMsg>,
    allocations: VecDeque<AllocMsg>,
    /// Newest allocation that each process acted on.
    acted_on: BTreeMap<u32, (u32, u32)>,
    pub(super) found: StormReport,
}

impl Checks {
    pub(super) fn new(number: Rc<Cell<u32>>) -> Self {
        Self {
            number,
            current: 0,
            frames: VecDeque::new(),
            pending: Vec::new(),
            allocations: VecDeque::new(),
            acted_on: BTreeMap::new(),
            found: StormReport::default(),
        }
    }

    pub(super) fn episode_started(&mut self) {
        self.current = self.number.get();
    }

    pub(super) fn allocated(&mut self, allocation: &AllocMsg) {
        remember(&mut self.allocations, *allocation);
        self.pending.push(*allocation);
    }

    /// Called after the step: the world already shows the next number.
    pub(super) fn tick(&mut self, report: &TickReport<'_>) {
        let number = std::mem::replace(&mut self.current, self.number.get());
        let TickReport { tick, absent, .. } = *report;
        remember(&mut self.frames, Published { tick, number, absent });
        self.found.ticks += 1;
        let everybody = (1 << AGENTS) - 1;
        self.found.ticks_with_fallback += u64::from(report.answered != everybody);
        for answer in report.answers() {
            self.check_answer(answer, number);
        }
        self.check_allocations();
    }

    fn check_answer(&mut self, answer: &ActionMsg, number: u32) {
        let order = (answer.alloc_term, answer.alloc_epoch);
        let decides = answer.task != UNASSIGNED;
        let is_torn = decides && (answer.has(ActionMsg::FALLBACK) || answer.q != number as f32);
        self.found.torn_frames += u64::from(is_torn);
        if answer.has(ActionMsg::NO_ALLOC) {
            self.found.wrong_assignments += u64::from(decides);
            return;
        }
        let newest = self.acted_on.entry(answer.runner).or_default();
        self.found.old_terms += u64::from(order < *newest);
        *newest = order;
        // One that was overtaken before the world looked is not known here.
        if let Some(stated) = self.allocations.iter().find(|stated| stated.order() == order) {
            let stated = stated.task.get(usize::from(answer.agent));
            self.found.wrong_assignments += u64::from(stated != Some(&answer.task));
        }
    }

    /// Allocations of frames that are not done yet are compared later.
    fn check_allocations(&mut self) {
        let Self { frames, pending, found, .. } = self;
        let newest = frames.back().map_or(0, |frame| frame.tick);
        pending.retain(|allocation| {
            if let Some(frame) = frames.iter().find(|frame| frame.tick == allocation.tick) {
                let is_right = |agent: usize| allocation.task[agent] == frame.task_of(agent);
                found.wrong_assignments += u64::from(!(0..AGENTS).all(is_right));
            }
            allocation.tick > newest
        });
    }
}

fn remember<T>(memory: &mut VecDeque<T>, item: T) {
    memory.push_back(item);
    if memory.len() > MEMORY {
        memory.pop_front();
    }
}
