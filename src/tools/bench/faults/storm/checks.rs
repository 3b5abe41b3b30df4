//! Checks that everything that arrives is whole, and what it says that it is.

use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

use sortie_core::roles::TickReport;
use sortie_core::wire::{ActionMsg, AllocMsg};

use super::StormReport;
use super::team::{AGENTS, task_of};

/// Frames and allocations that are remembered.
const MEMORY: usize = 256;

/// What was published, against which everything is held.
pub(super) struct Checks {
    number: Rc<Cell<u32>>,
    /// The number of the frame that the next report is about.
    current: u32,
    /// Newest frames: tick and number.
    frames: VecDeque<(u64, u32)>,
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
        remember(&mut self.frames, (report.tick, number));
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
        let decides = answer.task != sortie_core::UNASSIGNED;
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
        let newest = frames.back().map_or(0, |(tick, _)| *tick);
        pending.retain(|allocation| {
            let frame = frames.iter().find(|(tick, _)| *tick == allocation.tick);
            if let Some((_, number)) = frame {
                let is_right = |agent: usize| allocation.task[agent] == task_of(*number, agent);
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
