//! How a world writes its frames.

use super::{ActionMask, Phase, WorldError, WorldRole};
use crate::link::{LinkError, WorldLink};
use crate::policy::NO_ACTION;
use crate::roles::deadlines::act_within;
use crate::roles::fallback::fallback_action;
use crate::wire::{ABI, FrameHeader, FrameKind, FrameMut, Role};
use crate::world::World;

/// Count of the last tick of a term: the end of its episode and the goodbye still follow.
const LAST_COUNT: u32 = u32::MAX - 2;

impl WorldRole {
    pub(super) fn publish_tick<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &W,
    ) -> Result<(), WorldError> {
        self.count_tick()?;
        self.change_bundle();
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
            self.allocations_missed = self.allocations_missed.saturating_add(1);
        }
        if self.options.pipelined {
            flags |= FrameHeader::PIPELINED_ALLOC;
        }
        self.allocate_next = false;
        self.answered = 0;
        self.filled = self.seats.filled() & self.options.format.layout.every_agent();
        self.publish(link, world, FrameKind::World, flags)?;
        self.phase = Phase::Acting;
        if self.reallocated {
            link.ring(Role::Allocator)?;
        }
        // Agents that cannot act before the allocation are woken by the allocator.
        self.runners_rung = !self.reallocated || self.options.pipelined;
        if self.runners_rung {
            link.ring(Role::Runner)?;
        }
        Ok(())
    }

    /// The next tick, if the term has one left.
    pub(super) fn count_tick(&mut self) -> Result<(), WorldError> {
        if self.count >= LAST_COUNT {
            return Err(WorldError::TicksExhausted);
        }
        self.count += 1;
        Ok(())
    }

    /// Writes one frame into the link's memory and sends it.
    pub(super) fn publish<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &W,
        kind: FrameKind,
        flags: u16,
    ) -> Result<(), LinkError> {
        self.seq += 1;
        let now = link.now_ns();
        self.published_ns = now;
        let (seq, tick) = (self.seq, self.tick());
        let layout = self.options.format.layout;
        let act_within = act_within(self.options.period_ns, self.options.patience_ns);
        let deadline_ns = act_within.map_or(0, |patience| now.saturating_add(patience));
        self.deadline_ns = deadline_ns;
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
            generation: self.generation,
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
        let absent = self.seats.absent();
        // Besides those for whom nobody acts, those of whom the world says so.
        frame.set_progress(self.step, self.decision_tick, absent | frame.absent());
        let present = frame.present();
        self.present = 0;
        for agent in 0..self.options.format.layout.shape().agents {
            let last = self.last_actions.get(agent).copied().unwrap_or(NO_ACTION);
            frame.set_last_action(agent, last);
            // What an absent agent worked on is nobody's.
            let tasks = self.tasks.get(agent).filter(|_| absent >> agent & 1 == 0);
            frame.set_entity_task(agent, tasks.copied().unwrap_or(0));
            if present.contains(agent) {
                self.present |= 1 << agent;
            }
            let available = frame.available(agent);
            if let Some(action) = self.fallback.get_mut(agent) {
                *action = fallback_action(last, self.options.safe_action, available);
            }
            if let Some(actions) = self.available.get_mut(agent) {
                *actions = ActionMask::of(available);
            }
        }
    }
}
