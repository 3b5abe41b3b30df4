//! Where the parts of a frame's payload lie, from the shape of the domain.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::{FrameKind, assert_layout};
use crate::entity_mask::EntityMask;
use crate::limits;
use crate::shape::Shape;

/// Sections start at multiples of this.
const ALIGNMENT: usize = 64;
/// Rows are padded to multiples of this many features.
const STRIDE_STEP: usize = 8;

/// Fixed first part of a frame's payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct FrameHead {
    /// A.
    pub agents: u16,
    /// N.
    pub entities: u16,
    /// T.
    pub tasks: u16,
    /// U.
    pub actions: u16,
    /// d.
    pub features: u16,
    /// Columns of a row.
    pub stride: u16,
    /// The agent of a private frame, else 0xFFFF.
    pub agent: u16,
    /// Zero.
    pub reserved: u16,
    /// Bit t: subtask t is present and not finished.
    pub open_tasks: u32,
    /// Step in the episode.
    pub step: u32,
    /// Offsets of the sections, in their order; redundant, compared by the reader.
    pub offsets: [u32; 6],
    /// Newest tick, this one included, that asked for an allocation.
    pub decision_tick: u64,
    /// Bit a: nobody acts for agent a, whether it is present or not.
    pub absent: u64,
}

assert_layout!(FrameHead, 64, {
    agents: 0, entities: 2, tasks: 4, actions: 6, features: 8, stride: 10, agent: 12,
    reserved: 14, open_tasks: 16, step: 20, offsets: 24, decision_tick: 48, absent: 56,
});

/// A shape that the wire format cannot carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LayoutError {
    /// No agent, or more than the limit.
    Agents(usize),
    /// Fewer entities than agents, or more than the limit.
    Entities(usize),
    /// More subtasks than the limit.
    Tasks(usize),
    /// No action, or more than the limit.
    Actions(usize),
    /// No feature, or more than the limit.
    Features(usize),
    /// A private frame of an agent that does not exist.
    NoSuchAgent(usize),
}

impl core::fmt::Display for LayoutError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Agents(n) => write!(f, "{n} agents; a frame takes 1 to {}", limits::AGENTS),
            Self::Entities(n) => {
                write!(f, "{n} entities; a frame takes all agents and up to {}", limits::ENTITIES)
            }
            Self::Tasks(n) => write!(f, "{n} subtasks; a frame takes up to {}", limits::TASKS),
            Self::Actions(n) => write!(f, "{n} actions; a frame takes 1 to {}", limits::ACTIONS),
            Self::Features(n) => write!(f, "{n} features; a frame takes 1 to {}", limits::FEATURES),
            Self::NoSuchAgent(agent) => {
                write!(f, "there is no agent {agent} to get a private frame")
            }
        }
    }
}

impl core::error::Error for LayoutError {}

/// One section: its first byte and its length in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Section {
    pub(super) offset: usize,
    pub(super) bytes: usize,
}

/// Offsets and sizes of a frame's payload, computed alike by writer and readers.
///
/// A world frame has a row for every entity, which all agents read through their masks. A private frame is for
/// one agent: row 0 is its own, and the entities that it sees follow in rising order, itself among them where it
/// sees itself. So a decision adds up the same rows in the same order as with a world frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameLayout {
    shape: Shape,
    owner: Option<u16>,
    stride: usize,
    words: usize,
    sections: [Section; 6],
    len: usize,
    every_entity: EntityMask,
}

impl FrameLayout {
    /// Lays a world frame of this shape out.
    ///
    /// # Errors
    /// A count of the shape is zero where it must not be, or over its limit.
    pub fn new(shape: Shape) -> Result<Self, LayoutError> {
        check(shape)?;
        Ok(Self::of(shape, None, Counts::of_world(shape)))
    }

    /// Lays out the private frame of `agent` in a domain of this shape.
    ///
    /// # Errors
    /// As [`Self::new`]; there is no such agent; or a row for each entity and the own one are over the limit.
    pub fn private(shape: Shape, agent: usize) -> Result<Self, LayoutError> {
        check(shape)?;
        let counts = Counts::of_agent(shape);
        check(Shape { entities: counts.rows, ..shape })?;
        if agent >= shape.agents {
            return Err(LayoutError::NoSuchAgent(agent));
        }
        // The limit of agents fits the field.
        Ok(Self::of(shape, Some(agent as u16), counts))
    }

    fn of(shape: Shape, owner: Option<u16>, counts: Counts) -> Self {
        let words = shape.entities.div_ceil(64);
        let stride = shape.features.next_multiple_of(STRIDE_STEP);
        let mut end = size_of::<FrameHead>();
        let sections = section_bytes(shape, counts).map(|bytes| {
            let section = Section { offset: end.next_multiple_of(ALIGNMENT), bytes };
            end = section.offset + bytes;
            section
        });
        let len = whole_bytes(section_bytes(shape, counts));
        debug_assert_eq!(len, end.next_multiple_of(ALIGNMENT));
        debug_assert!(len <= limits::FRAME_BYTES);
        let every_entity = EntityMask::first(shape.entities);
        Self { shape, owner, stride, words, sections, len, every_entity }
    }

    /// The agent whose private frame this is.
    pub fn owner(&self) -> Option<usize> {
        self.owner.map(usize::from)
    }

    /// What frames of this layout are for, but for warm-ups.
    pub fn kind(&self) -> FrameKind {
        if self.owner.is_some() { FrameKind::Private } else { FrameKind::World }
    }

    /// The shape of the domain, that of the agents who get private frames included.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Bytes of the payload.
    pub fn payload_bytes(&self) -> usize {
        self.len
    }

    /// Columns of a row: d, rounded up.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Words of 64 bits of one set of entities.
    pub(super) fn words(&self) -> usize {
        self.words
    }

    pub(super) fn sections(&self) -> &[Section; 6] {
        &self.sections
    }

    pub(crate) fn every_entity(&self) -> EntityMask {
        self.every_entity
    }

    /// Bit t for every subtask.
    pub(crate) fn every_task(&self) -> u32 {
        low_bits(self.shape.tasks) as u32
    }

    /// Bit a for every agent.
    pub fn every_agent(&self) -> u64 {
        low_bits(self.shape.agents)
    }

    /// The head that a writer starts from and that a reader expects, but for its changing fields.
    pub(super) fn head(&self) -> FrameHead {
        // The limits of `check` fit the fields.
        FrameHead {
            agents: if self.owner.is_some() { 1 } else { self.shape.agents as u16 },
            entities: self.shape.entities as u16,
            tasks: self.shape.tasks as u16,
            actions: self.shape.actions as u16,
            features: self.shape.features as u16,
            stride: self.stride as u16,
            agent: self.owner.unwrap_or(u16::MAX),
            reserved: 0,
            open_tasks: 0,
            step: 0,
            offsets: self.sections.map(|section| section.offset as u32),
            decision_tick: 0,
            absent: 0,
        }
    }
}

/// How many items the sections of a frame have.
#[derive(Clone, Copy)]
struct Counts {
    /// Agents that are told what they see and may do.
    agents: usize,
    /// Entities with features and subtasks.
    rows: usize,
    /// Rows with a last action.
    last_actions: usize,
}

impl Counts {
    const fn of_world(shape: Shape) -> Self {
        Self { agents: shape.agents, rows: shape.entities, last_actions: shape.agents }
    }

    /// Any row of a private frame may be another agent's.
    const fn of_agent(shape: Shape) -> Self {
        let rows = shape.entities.saturating_add(1);
        Self { agents: 1, rows, last_actions: rows }
    }
}

/// Bytes of the sections of a frame of `shape`, in their order.
const fn section_bytes(shape: Shape, counts: Counts) -> [usize; 6] {
    let Shape { entities, actions, features, .. } = shape;
    let Counts { agents, rows, last_actions } = counts;
    let set = entities.div_ceil(64) * 8;
    let row = features.next_multiple_of(STRIDE_STEP) * 4;
    [set, agents * set, rows * 4, agents * actions * 2, last_actions * 2, rows * row]
}

/// Bytes of the payload of a world frame of `shape`, which has to be one that a frame can have.
#[cfg(feature = "serial")]
pub(crate) const fn payload_bytes(shape: Shape) -> usize {
    whole_bytes(section_bytes(shape, Counts::of_world(shape)))
}

/// Bytes of a payload with these sections.
const fn whole_bytes(sections: [usize; 6]) -> usize {
    let [a, b, c, d, e, f] = sections;
    let whole = [size_of::<FrameHead>(), a, b, c, d, e, f];
    let (mut bytes, mut rest) = (0, whole.as_slice());
    while let [section, others @ ..] = rest {
        bytes += section.next_multiple_of(ALIGNMENT);
        rest = others;
    }
    bytes
}

/// What one running domain's frames look like: their layout and the schema they must name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameFormat {
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// Where the parts lie.
    pub layout: FrameLayout,
}

fn low_bits(count: usize) -> u64 {
    if count >= 64 { u64::MAX } else { (1 << count) - 1 }
}

fn check(shape: Shape) -> Result<(), LayoutError> {
    let Shape { agents, entities, tasks, actions, features } = shape;
    if agents == 0 || agents > limits::AGENTS {
        return Err(LayoutError::Agents(agents));
    }
    if entities < agents || entities > limits::ENTITIES {
        return Err(LayoutError::Entities(entities));
    }
    if tasks > limits::TASKS {
        return Err(LayoutError::Tasks(tasks));
    }
    if actions == 0 || actions > limits::ACTIONS {
        return Err(LayoutError::Actions(actions));
    }
    if features == 0 || features > limits::FEATURES {
        return Err(LayoutError::Features(features));
    }
    Ok(())
}

// The largest shape that `check` takes fits the limit of a frame.
const _: () = assert!(
    limits::ENTITIES * limits::FEATURES * 4 + limits::AGENTS * limits::ACTIONS * 2 + (1 << 14)
        <= limits::FRAME_BYTES
);

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(agents: usize, entities: usize, actions: usize, features: usize) -> usize {
        let shape = Shape { agents, entities, tasks: 4, actions, features };
        FrameLayout::new(shape).unwrap().payload_bytes()
    }

    #[test]
    fn has_the_documented_sizes() {
        assert_eq!(bytes(5, 11, 12, 58), 3_264);
        assert_eq!(bytes(8, 16, 14, 42), 3_648);
    }

    #[test]
    fn a_private_frame_has_room_for_its_own_row_and_all_that_may_be_seen() {
        let shape = Shape { agents: 5, entities: 11, tasks: 4, actions: 12, features: 58 };
        let layout = FrameLayout::private(shape, 3).unwrap();
        assert_eq!(
            (layout.payload_bytes(), layout.owner(), layout.shape()),
            (3_456, Some(3), shape)
        );
        assert_eq!(
            (layout.kind(), layout.head().agents, layout.head().agent),
            (FrameKind::Private, 1, 3)
        );
        assert_eq!(FrameLayout::private(shape, 5), Err(LayoutError::NoSuchAgent(5)));
        let full = Shape { entities: 128, ..shape };
        assert_eq!(FrameLayout::private(full, 0), Err(LayoutError::Entities(129)));
    }

    #[test]
    fn refuses_what_the_wire_cannot_carry() {
        let good = Shape { agents: 2, entities: 3, tasks: 1, actions: 4, features: 5 };
        assert!(FrameLayout::new(good).is_ok());
        let refused = [
            (Shape { agents: 0, ..good }, LayoutError::Agents(0)),
            (Shape { agents: 65, entities: 70, ..good }, LayoutError::Agents(65)),
            (Shape { entities: 1, ..good }, LayoutError::Entities(1)),
            (Shape { entities: 129, ..good }, LayoutError::Entities(129)),
            (Shape { tasks: 33, ..good }, LayoutError::Tasks(33)),
            (Shape { actions: 0, ..good }, LayoutError::Actions(0)),
            (Shape { features: 2049, ..good }, LayoutError::Features(2049)),
        ];
        for (shape, error) in refused {
            assert_eq!(FrameLayout::new(shape), Err(error));
        }
    }
}
