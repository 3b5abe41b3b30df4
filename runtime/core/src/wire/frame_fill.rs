//! Writing a frame in place, into a loaned sample or any aligned buffer.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::frame_layout::Section;
use super::{FrameError, FrameHead, FrameLayout};
use crate::entity_mask::EntityMask;
use crate::policy::NO_ACTION;

/// A frame's payload while it is written. Entities, agents and actions beyond the domain's counts
/// are ignored; nothing here can fail.
#[derive(Debug)]
pub struct FrameMut<'a> {
    layout: FrameLayout,
    head: &'a mut FrameHead,
    present: &'a mut [u64],
    observable: &'a mut [u64],
    entity_task: &'a mut [u32],
    available: &'a mut [u16],
    last_actions: &'a mut [u16],
    rows: &'a mut [f32],
}

impl<'a> FrameMut<'a> {
    /// Clears `payload` and writes the head: nothing present, nothing visible, nothing available.
    ///
    /// # Errors
    /// [`FrameError::Length`]: not the layout's length, or not aligned to 64 bytes.
    pub fn new(payload: &'a mut [u8], layout: FrameLayout) -> Result<Self, FrameError> {
        if payload.len() != layout.payload_bytes() {
            return Err(FrameError::Length);
        }
        payload.fill(0);
        let (head, rest) = FrameHead::mut_from_prefix(payload).map_err(|_| FrameError::Length)?;
        *head = layout.head();
        let mut cutter = Cutter { at: size_of::<FrameHead>(), rest };
        let [present, observable, entity_task, available, last_actions, rows] = *layout.sections();
        let frame = Self {
            layout,
            head,
            present: cutter.cut(present)?,
            observable: cutter.cut(observable)?,
            entity_task: cutter.cut(entity_task)?,
            available: cutter.cut(available)?,
            last_actions: cutter.cut(last_actions)?,
            rows: cutter.cut(rows)?,
        };
        frame.last_actions.fill(NO_ACTION);
        Ok(frame)
    }

    /// The layout written to.
    pub fn layout(&self) -> &FrameLayout {
        &self.layout
    }

    /// The d features of `entity`, to be written; empty for one that does not exist.
    pub fn row_mut(&mut self, entity: usize) -> &mut [f32] {
        let (stride, features) = (self.layout.stride(), self.layout.shape().features);
        let first = entity.saturating_mul(stride);
        self.rows.get_mut(first..first.saturating_add(features)).unwrap_or_default()
    }

    /// All features `[N, stride]`, to be written; columns from d on stay 0.
    pub fn rows_mut(&mut self) -> &mut [f32] {
        self.rows
    }

    /// States which entities exist.
    pub fn set_present(&mut self, entities: &EntityMask) {
        let entities = entities.and(&self.layout.every_entity());
        copy_words(self.present, &entities);
    }

    /// The entities stated to exist.
    pub fn present(&self) -> EntityMask {
        EntityMask::from_words(self.present)
    }

    /// States which entities `agent` sees.
    pub fn set_observable(&mut self, agent: usize, entities: &EntityMask) {
        let entities = entities.and(&self.layout.every_entity());
        copy_words(row_mut(self.observable, agent, self.layout.words()), &entities);
    }

    /// Availability codes `[U]` of `agent`, 0 = not available; empty for one that does not exist.
    pub fn available_mut(&mut self, agent: usize) -> &mut [u16] {
        row_mut(self.available, agent, self.layout.shape().actions)
    }

    /// Availability codes `[U]` of `agent` as written so far.
    pub fn available(&self, agent: usize) -> &[u16] {
        let actions = self.layout.shape().actions;
        self.available.get(agent * actions..(agent + 1) * actions).unwrap_or_default()
    }

    /// States the subtasks that `entity` belongs to: bit t = subtask t.
    pub fn set_entity_task(&mut self, entity: usize, tasks: u32) {
        if let Some(to) = self.entity_task.get_mut(entity) {
            *to = tasks & self.layout.every_task();
        }
    }

    /// States which subtasks are present and not finished: bit t = subtask t.
    pub fn set_open_tasks(&mut self, tasks: u32) {
        self.head.open_tasks = tasks & self.layout.every_task();
    }

    /// States the agents that are dead or have failed for good, whom allocators leave out: bit a for agent a. Their bodies may
    /// be present.
    pub fn set_absent(&mut self, agents: u64) {
        self.head.absent = agents & self.layout.every_agent();
    }

    /// The agents that are absent so far.
    pub fn absent(&self) -> u64 {
        self.head.absent
    }

    /// States the last action of `agent`. The world role writes it.
    pub fn set_last_action(&mut self, agent: usize, action: u16) {
        if let Some(to) = self.last_actions.get_mut(agent) {
            *to = action;
        }
    }

    /// States the step in the episode, the newest decision tick, and the agents that are absent: bit a for agent a. The
    /// world role writes them.
    pub fn set_progress(&mut self, step: u32, decision_tick: u64, absent: u64) {
        self.head.step = step;
        self.head.decision_tick = decision_tick;
        self.head.absent = absent & self.layout.every_agent();
    }
}

fn copy_words(to: &mut [u64], entities: &EntityMask) {
    for (to, from) in to.iter_mut().zip(entities.words()) {
        *to = *from;
    }
}

fn row_mut<T>(items: &mut [T], index: usize, columns: usize) -> &mut [T] {
    let first = index.saturating_mul(columns);
    items.get_mut(first..first.saturating_add(columns)).unwrap_or_default()
}

/// Cuts the sections, which lie in order, off the front of what is left.
struct Cutter<'a> {
    at: usize,
    rest: &'a mut [u8],
}

impl<'a> Cutter<'a> {
    fn cut<T: FromBytes + IntoBytes + Immutable + KnownLayout>(
        &mut self,
        section: Section,
    ) -> Result<&'a mut [T], FrameError> {
        let rest = core::mem::take(&mut self.rest);
        let gap = section.offset.checked_sub(self.at).ok_or(FrameError::Length)?;
        let (_, rest) = rest.split_at_mut_checked(gap).ok_or(FrameError::Length)?;
        let (bytes, rest) = rest.split_at_mut_checked(section.bytes).ok_or(FrameError::Length)?;
        self.rest = rest;
        self.at = section.offset + section.bytes;
        <[T]>::mut_from_bytes(bytes).map_err(|_| FrameError::Length)
    }
}
