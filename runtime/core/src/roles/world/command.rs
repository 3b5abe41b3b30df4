//! What a world is told from outside. It obeys between two ticks: the current one is always played, unless what was seen
//! in it is no longer so.

use super::{Phase, WorldError, WorldObserver, WorldRole, ring_all};
use crate::link::{LinkError, WorldLink};
use crate::roles::Poll;
use crate::wire::{FrameHeader, FrameKind, SwapMoment};
use crate::world::World;

/// Allocations that a leader may leave unanswered before it is asked to step down.
const LEADER_CHANCES: u32 = 3;

/// What a world has been told and has not done yet.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Orders {
    /// It is to stand still.
    pause: bool,
    /// The episode is to be given up.
    reset: bool,
    /// What the current frame shows is no longer so.
    anew: bool,
    /// The generation of the bundle to change to, and when.
    swap: Option<(u16, SwapMoment)>,
    /// The world is to end.
    end: bool,
}

/// Whether the leading allocator is to step down.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chances {
    /// The number of allocations missed at which the leader has had its chances.
    used_up_at: u32,
    silent: Option<u32>,
}

impl Default for Chances {
    fn default() -> Self {
        Self { used_up_at: LEADER_CHANCES, silent: None }
    }
}

impl WorldRole {
    /// Stands still from the end of the current tick on, until it is told to [`Self::resume`].
    pub fn pause(&mut self) {
        self.orders.pause = true;
    }

    /// Goes on. The next tick asks for a new allocation.
    pub fn resume(&mut self) {
        self.orders.pause = false;
    }

    /// Gives up the episode before the next tick, and begins another. The one given up does not count.
    pub fn reset_episode(&mut self) {
        self.orders.reset = true;
    }

    /// Somebody has changed the world while its team was deciding: answers to the current frame are void, the team sees
    /// the world anew in another, which asks for a new allocation. A frame that is still to come shows the change anyway.
    pub fn observe_anew(&mut self) {
        self.orders.anew = self.phase == Phase::Acting;
    }

    /// The generation of the bundle that the newest frame asks answers of.
    pub fn generation(&self) -> u16 {
        self.generation
    }

    /// Asks for the answers of this generation's bundle from the first frame on: for a world that takes another's place.
    pub fn begin_with_generation(&mut self, generation: u16) {
        self.generation = generation;
    }

    /// Asks for the answers of another generation's bundle, from one tick on, which asks for a new allocation as well:
    /// nobody acts on one that another bundle made.
    pub fn change_generation(&mut self, generation: u16, moment: SwapMoment) {
        self.orders.swap = Some((generation, moment));
    }

    /// Ends with the next poll, and the team with it.
    pub fn end(&mut self) {
        self.orders.end = true;
    }

    /// Whether it stands still, or is about to.
    pub fn is_paused(&self) -> bool {
        self.orders.pause
    }

    /// The process id of a leading allocator that has left three allocations unanswered and is to step down;
    /// once for every three.
    pub fn take_silent_leader(&mut self) -> Option<u32> {
        self.chances.silent.take()
    }

    /// An allocation came.
    pub(super) fn leader_answered(&mut self) {
        self.allocations_missed = 0;
        self.chances = Chances::default();
    }

    /// After a tick: its allocation is late if it has not come by now.
    pub(super) fn watch_leader(&mut self) {
        if self.allocations_missed >= self.chances.used_up_at && self.awaits_allocation() {
            self.chances.silent = self.seats.leader();
            self.chances.used_up_at = self.allocations_missed.saturating_add(LEADER_CHANCES);
        }
    }

    /// Before a tick: changes to the bundle that is due now, if there is one.
    pub(super) fn change_bundle(&mut self) {
        let is_due = |moment| moment == SwapMoment::NextTick || self.step == 0;
        if let Some((generation, _)) = self.orders.swap.take_if(|(_, moment)| is_due(*moment)) {
            self.generation = generation;
            self.allocate_next = true;
        }
    }

    /// The next frame is due now, and asks for an allocation.
    pub(super) fn ask_again(&mut self, now: u64) -> Poll {
        self.allocate_next = true;
        self.phase = Phase::Pacing { until_ns: now };
        Poll::Again
    }

    pub(super) fn is_observed_anew(&mut self) -> bool {
        core::mem::take(&mut self.orders.anew)
    }

    pub(super) fn is_told_to_end(&self) -> bool {
        self.orders.end
    }

    /// Does what is to be done between two ticks, if there is something.
    pub(super) fn obey<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &mut W,
        observer: &mut dyn WorldObserver,
    ) -> Result<Option<Poll>, WorldError> {
        if core::mem::take(&mut self.orders.reset) && self.step > 0 {
            self.count_tick()?;
            self.publish_between_ticks(link, world, FrameHeader::EPISODE_END)?;
            self.begin_next_episode(world, observer);
            return Ok(Some(Poll::Again));
        }
        if !self.orders.pause {
            return Ok(None);
        }
        self.count_tick()?;
        self.publish_between_ticks(link, world, FrameHeader::PAUSED)?;
        ring_all(link)?;
        self.phase = Phase::Paused;
        Ok(Some(Poll::Again))
    }

    /// A frame that asks for no action changes nothing about when the next tick is due.
    pub(super) fn publish_between_ticks<W: World + ?Sized>(
        &mut self,
        link: &mut impl WorldLink,
        world: &W,
        flags: u16,
    ) -> Result<(), LinkError> {
        let paced = self.phase;
        self.publish(link, world, FrameKind::World, flags)?;
        self.phase = paced;
        Ok(())
    }
}
