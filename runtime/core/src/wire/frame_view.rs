//! Reading a frame: checked once, then read in place without checks that can fail.

use zerocopy::{FromBytes, Immutable, KnownLayout};

use super::frame_layout::Section;
use super::{FrameFormat, FrameHead, FrameHeader};
use crate::allocator::AllocationState;
use crate::entity_mask::EntityMask;
use crate::limits;
use crate::policy::{NO_ACTION, Observation};
use crate::shape::Shape;

/// Why a frame is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FrameError {
    /// Magic, ABI or schema are not this domain's.
    Foreign,
    /// The payload's length, or its alignment, is not that of the layout.
    Length,
    /// Counts or offsets differ from the layout.
    Layout,
    /// A set names an entity, a subtask or an action that the domain does not have, or ticks contradict
    /// each other.
    Content,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Foreign => "the frame is of another schema or ABI",
            Self::Length => "the frame's payload has the wrong length or alignment",
            Self::Layout => "the frame's counts or offsets differ from the domain's",
            Self::Content => "the frame names what does not exist, or contradicts itself",
        })
    }
}

impl core::error::Error for FrameError {}

/// A checked frame, read in place.
#[derive(Clone, Copy, Debug)]
pub struct FrameView<'a> {
    header: &'a FrameHeader,
    head: &'a FrameHead,
    owner: Option<usize>,
    stride: usize,
    words: usize,
    present: EntityMask,
    observable: &'a [u64],
    entity_task: &'a [u32],
    available: &'a [u16],
    last_actions: &'a [u16],
    rows: &'a [f32],
}

impl<'a> FrameView<'a> {
    /// Checks a frame against the domain's format. Costs one pass over all but the features.
    ///
    /// # Errors
    /// See [`FrameError`]; such a frame is dropped and counted.
    pub fn new(
        header: &'a FrameHeader,
        payload: &'a [u8],
        format: &FrameFormat,
    ) -> Result<Self, FrameError> {
        let view = Self::checked_before(header, payload, format)?;
        let is_sound = view.agrees_with_header() && view.names_only_what_exists(format);
        if is_sound { Ok(view) } else { Err(FrameError::Content) }
    }

    /// Reads a frame whose content has been checked.
    ///
    /// # Errors
    /// As [`Self::new`], but for the content.
    pub(crate) fn checked_before(
        header: &'a FrameHeader,
        payload: &'a [u8],
        format: &FrameFormat,
    ) -> Result<Self, FrameError> {
        let layout = &format.layout;
        if !header.fits(format.schema) {
            return Err(FrameError::Foreign);
        }
        if payload.len() != layout.payload_bytes() || header.len as usize != payload.len() {
            return Err(FrameError::Length);
        }
        let (head, _) = FrameHead::ref_from_prefix(payload).map_err(|_| FrameError::Length)?;
        let expected = FrameHead {
            open_tasks: head.open_tasks,
            step: head.step,
            decision_tick: head.decision_tick,
            absent: head.absent,
            ..layout.head()
        };
        if *head != expected {
            return Err(FrameError::Layout);
        }
        let [present, observable, entity_task, available, last_actions, rows] = layout.sections();
        Ok(Self {
            header,
            head,
            owner: layout.owner(),
            stride: layout.stride(),
            words: layout.words(),
            present: EntityMask::from_words(section(payload, present)?),
            observable: section(payload, observable)?,
            entity_task: section(payload, entity_task)?,
            available: section(payload, available)?,
            last_actions: section(payload, last_actions)?,
            rows: section(payload, rows)?,
        })
    }

    /// The tick is of the world's term; step and decision tick are not beyond it.
    fn agrees_with_header(&self) -> bool {
        let FrameHeader { tick, world_term, .. } = *self.header;
        let is_of_term = |tick: u64| tick >> 32 == u64::from(world_term);
        let earliest = tick.saturating_sub(u64::from(self.head.step));
        is_of_term(tick) && is_of_term(earliest) && self.head.decision_tick <= tick
    }

    fn names_only_what_exists(&self, format: &FrameFormat) -> bool {
        let layout = &format.layout;
        let every_entity = layout.every_entity();
        let entities_exist = |set: EntityMask| set.and(&every_entity) == set;
        let tasks = self.entity_task.iter().fold(self.head.open_tasks, |all, one| all | one);
        let Shape { agents, actions, .. } = layout.shape();
        entities_exist(self.present)
            && (0..agents).all(|agent| entities_exist(self.observable(agent)))
            && self.shows_the_owner_only_what_it_sees()
            && tasks & !layout.every_task() == 0
            && self.head.absent & !layout.every_agent() == 0
            && self
                .last_actions
                .iter()
                .all(|&action| action == NO_ACTION || usize::from(action) < actions)
    }

    /// A private frame names its owner, if it is present, and what it sees of the present entities.
    fn shows_the_owner_only_what_it_sees(&self) -> bool {
        let Some(owner) = self.owner else { return true };
        let mut shown = self.observable(owner);
        shown.insert(owner);
        self.present == shown || self.present.is_empty() && self.observable(owner).is_empty()
    }

    /// The header.
    pub fn header(&self) -> &'a FrameHeader {
        self.header
    }

    /// Agents that are told what they see: A, or 1 in a private frame.
    pub fn agents(&self) -> usize {
        usize::from(self.head.agents)
    }

    /// The agent whose private frame this is.
    pub fn owner(&self) -> Option<usize> {
        self.owner
    }

    /// Step in the episode.
    pub fn step(&self) -> u32 {
        self.head.step
    }

    /// The tick of the episode's first frame.
    pub fn episode_start(&self) -> u64 {
        self.header.tick.saturating_sub(u64::from(self.head.step))
    }

    /// Newest tick, this one included, that asked for an allocation.
    pub fn decision_tick(&self) -> u64 {
        self.head.decision_tick
    }

    /// Bit a: nobody has acted for agent a for some ticks, or it is dead, and allocators leave it out. Its body may be
    /// present.
    pub fn absent(&self) -> u64 {
        self.head.absent
    }

    /// Bit t: subtask t is present and not finished.
    pub fn open_tasks(&self) -> u32 {
        self.head.open_tasks
    }

    /// The entities that exist; of a private frame, those that are shown.
    pub fn present(&self) -> EntityMask {
        self.present
    }

    /// The entities that `agent` sees; none for an agent that does not exist, or gets another private frame.
    pub fn observable(&self, agent: usize) -> EntityMask {
        EntityMask::from_words(row(self.observable, self.place(agent), self.words))
    }

    /// The subtasks of every row: bit t where its entity belongs to subtask t; agents: their last allocation.
    pub fn entity_task(&self) -> &'a [u32] {
        self.entity_task
    }

    /// Availability codes `[U]` of `agent`, 0 = not available; empty for one that does not exist, or gets another
    /// private frame.
    pub fn available(&self, agent: usize) -> &'a [u16] {
        row(self.available, self.place(agent), usize::from(self.head.actions))
    }

    /// Last actions `[A]`, in a private frame of every row; [`NO_ACTION`] where there was none.
    pub fn last_actions(&self) -> &'a [u16] {
        self.last_actions
    }

    /// Features, `[N, stride]` or those of a private frame's rows.
    pub fn rows(&self) -> &'a [f32] {
        self.rows
    }

    /// Columns of a row.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Which entity each row of `owner`'s private frame shows.
    pub(crate) fn shown(&self, owner: usize) -> impl Iterator<Item = usize> + use<> {
        let seen = self.observable(owner);
        // Row 0 is the owner's, whether it sees itself or not.
        let own = self.present.contains(owner).then_some(owner);
        own.into_iter().chain((0..limits::ENTITIES).filter(move |&entity| seen.contains(entity)))
    }

    /// What `agent` decides on, where it may attend to `visible`.
    pub fn observation(&self, agent: usize, visible: &EntityMask) -> Observation<'a> {
        Observation {
            rows: self.rows,
            stride: self.stride,
            last_actions: self.last_actions,
            visible: self.rows_of(visible),
            self_index: if self.owner.is_some() { 0 } else { agent },
            available: self.available(agent),
        }
    }

    /// The rows that show these entities; the owner's first one is nobody's to attend to.
    fn rows_of(&self, entities: &EntityMask) -> EntityMask {
        let Some(owner) = self.owner else { return *entities };
        let mut rows = EntityMask::EMPTY;
        for (row, entity) in self.shown(owner).enumerate().skip(1) {
            if entities.contains(entity) {
                rows.insert(row);
            }
        }
        rows
    }

    /// Where `agent` stands among those who are told what they see.
    fn place(&self, agent: usize) -> usize {
        match self.owner {
            None => agent,
            Some(owner) if owner == agent => 0,
            Some(_) => usize::MAX,
        }
    }

    /// All that an allocator sees, who counts on agents for which somebody acts and sees no others; of a private frame
    /// nothing that one could work on.
    pub fn allocation_state(&self) -> AllocationState<'a> {
        AllocationState {
            agents: self.agents(),
            tasks: usize::from(self.head.tasks),
            rows: self.rows,
            stride: self.stride,
            present: self.present.without(&EntityMask::from_words(&[self.head.absent])),
            entity_task: self.entity_task,
            open_tasks: self.head.open_tasks,
            available: if self.owner.is_none() { self.available } else { &[] },
        }
    }
}

/// Row `index` of `columns` items, empty where it does not exist.
fn row<T>(items: &[T], index: usize, columns: usize) -> &[T] {
    let start = index.saturating_mul(columns);
    items.get(start..start.saturating_add(columns)).unwrap_or_default()
}

fn section<'a, T: FromBytes + Immutable + KnownLayout>(
    payload: &'a [u8],
    section: &Section,
) -> Result<&'a [T], FrameError> {
    payload
        .get(section.offset..section.offset + section.bytes)
        .and_then(|bytes| <[T]>::ref_from_bytes(bytes).ok())
        .ok_or(FrameError::Length)
}
