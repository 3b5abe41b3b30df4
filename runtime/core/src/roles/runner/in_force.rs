//! Which allocation a runner's agents act on: the newest while it may be used, then the heuristic's.

use super::RunnerRole;
use crate::allocator::{Allocator, UNASSIGNED};
use crate::limits;
use crate::roles::deadlines::allocate_by;
use crate::roles::feasible::allocate;
use crate::wire::{FrameHeader, FrameView};

/// How usable the newest allocation is for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Freshness {
    Fresh,
    Stale,
    None,
}

/// The subtasks that agents act for in a frame.
pub(super) struct InForce {
    pub(super) freshness: Freshness,
    task: [u8; limits::AGENTS],
    /// Term and epoch of the allocation; zeros where there is none.
    pub(super) order: (u32, u32),
}

impl InForce {
    pub(super) fn task_of(&self, agent: usize) -> Option<u8> {
        self.task.get(agent).copied().filter(|&task| task != UNASSIGNED)
    }
}

/// The subtasks `[N]` of the entities that the frame shows, agents' overwritten by those in force.
pub(super) fn subtasks(
    view: &FrameView<'_>,
    agents: usize,
    in_force: &InForce,
) -> [u32; limits::ENTITIES] {
    let mut subtasks = [0; limits::ENTITIES];
    let mut set = |entity: usize, tasks: u32| {
        if let Some(to) = subtasks.get_mut(entity) {
            *to = tasks;
        }
    };
    let rows = view.entity_task().iter().copied();
    match view.owner() {
        None => rows.enumerate().for_each(|(entity, tasks)| set(entity, tasks)),
        Some(owner) => view.shown(owner).zip(rows).for_each(|(entity, tasks)| set(entity, tasks)),
    }
    for (agent, to) in subtasks.iter_mut().enumerate().take(agents) {
        let task = in_force.task_of(agent);
        *to = task.and_then(|task| 1u32.checked_shl(u32::from(task))).unwrap_or(0);
    }
    subtasks
}

impl RunnerRole {
    fn freshness(&self, view: &FrameView<'_>) -> Freshness {
        let Some(allocation) =
            self.allocation.get().filter(|newest| newest.tick >= view.episode_start())
        else {
            return Freshness::None;
        };
        let tick = view.header().tick;
        let is_fresh = if view.header().has(FrameHeader::PIPELINED_ALLOC) {
            allocation.valid_until >= tick
        } else {
            allocation.tick >= view.decision_tick()
        };
        let grace = 2 * u64::from(self.options.decision_interval);
        if is_fresh {
            Freshness::Fresh
        } else if tick <= allocation.valid_until.saturating_add(grace) {
            Freshness::Stale
        } else {
            Freshness::None
        }
    }

    /// Until when the agents wait for the frame's allocation, if they do. Once it has not come in time,
    /// later frames of the same decision do not wait for it again.
    pub(super) fn awaits_allocation(&mut self, view: &FrameView<'_>, now_ns: u64) -> Option<u64> {
        let header = view.header();
        let waits = self.options.subtasks
            && !header.has(FrameHeader::PIPELINED_ALLOC)
            && self.given_up.is_none_or(|given_up| view.decision_tick() > given_up)
            && self.freshness(view) != Freshness::Fresh;
        let until_ns = allocate_by(header.t_ns, header.deadline_ns, self.options.period_ns);
        if waits && now_ns >= until_ns {
            self.given_up = Some(view.decision_tick());
        }
        (waits && now_ns < until_ns).then_some(until_ns)
    }

    /// What the agents act for: the newest allocation while it may be used, then the heuristic's, if there
    /// is one that allocates this frame, else nothing. A private frame shows too little of the team for it.
    pub(super) fn in_force(
        &self,
        view: &FrameView<'_>,
        heuristic: Option<&mut dyn Allocator>,
    ) -> InForce {
        let freshness = self.freshness(view);
        let nothing = [UNASSIGNED; limits::AGENTS];
        let mut in_force = InForce { freshness, task: nothing, order: (0, 0) };
        let usable = self.allocation.get().filter(|_| freshness != Freshness::None);
        if let Some(newest) = usable {
            in_force.task = newest.task;
            in_force.order = newest.order();
        } else if let Some(heuristic) = heuristic.filter(|_| self.options.subtasks)
            && view.owner().is_none()
            && allocate(heuristic, view, &mut in_force.task).is_err()
        {
            in_force.task = nothing;
        }
        in_force
    }
}
