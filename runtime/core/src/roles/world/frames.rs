//! How a world writes its frames.

use super::{Phase, WorldError, WorldRole};
use crate::link::{LinkError, WorldLink};
use crate::policy::NO_ACTION;
use crate::roles::fallback::fallback_action;
use crate::wire::{ABI, FrameHeader, FrameKind, FrameMut, Role};
use crate::world::World;

impl WorldRole {
    pub(super) fn publish_tick<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &W,
    ) -> Result<(), WorldError> {
        self.count += 1;
        let since = self.tick().saturating_sub(self.decision_tick);
        let is_due = since >= u64::from(self.options.decision_interval);
        self.reallocated = self.options.allocator && (self.allocate_next || is_due);
        let mut flags = 0;
        if self.step == 0 {
            flags |= FrameHeader::EPISODE_START;
        }
        if self.reallocated {
            flags |= FrameHeader::REALLOC;
            self.decision_tick = self.tick();
        }
        self.allocate_next = false;
        self.answered = 0;
        self.publish(link, world, FrameKind::World, flags)?;
        self.phase = Phase::Acting;
        // Agents cannot act before the allocation: the allocator wakes them.
        Ok(link.ring(if self.reallocated { Role::Allocator } else { Role::Runner })?)
    }

    /// Writes one frame into the link's memory and sends it.
    pub(super) fn publish<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &W,
        kind: FrameKind,
        flags: u32,
    ) -> Result<(), LinkError> {
        self.seq += 1;
        let now = link.now_ns();
        self.published_ns = now;
        let (seq, tick) = (self.seq, self.tick());
        let layout = self.options.format.layout;
        let deadline_ns = match self.options.patience_ns {
            0 => 0,
            patience => now.saturating_add(patience),
        };
        let header = FrameHeader {
            magic: FrameHeader::MAGIC,
            abi: ABI,
            kind: kind as u16,
            schema: self.options.format.schema,
            seq,
            tick,
            t_ns: now,
            deadline_ns,
            // The limit of a frame fits the field.
            len: layout.payload_bytes() as u32,
            flags,
            world_term: self.options.term,
            episode: self.episode,
        };
        link.send_frame(&mut |payload| {
            let mut frame = FrameMut::new(payload, layout).map_err(LinkError::Frame)?;
            world.observe(&mut frame);
            self.complete(&mut frame);
            Ok(header)
        })
    }

    /// Adds what the role knows to a frame, and notes who must answer it.
    fn complete(&mut self, frame: &mut FrameMut<'_>) {
        frame.set_progress(self.step, self.decision_tick, self.seats.joined());
        let present = frame.present();
        self.present = 0;
        for agent in 0..self.options.format.layout.shape().agents {
            let last = self.last_actions.get(agent).copied().unwrap_or(NO_ACTION);
            frame.set_last_action(agent, last);
            frame.set_entity_task(agent, self.tasks.get(agent).copied().unwrap_or(0));
            if present.contains(agent) {
                self.present |= 1 << agent;
            }
            if let Some(action) = self.fallback.get_mut(agent) {
                *action = fallback_action(last, self.options.safe_action, frame.available(agent));
            }
        }
    }
}
