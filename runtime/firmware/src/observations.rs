//! Recorded observations, read one after the other: `docs/reference/recorded-files.md` has the format.

use sortie_core::{EntityMask, Observation};
use zerocopy::IntoBytes;

use crate::file::File;

/// Room for what one agent sees: `ROWS` floats of features, `ENTITIES` rows, `ACTIONS` actions.
pub(crate) struct Room<const ROWS: usize, const ENTITIES: usize, const ACTIONS: usize> {
    rows: [f32; ROWS],
    last_actions: [u16; ENTITIES],
    available: [u16; ACTIONS],
    visible: [u64; 2],
    own: u16,
}

impl<const ROWS: usize, const ENTITIES: usize, const ACTIONS: usize> Room<ROWS, ENTITIES, ACTIONS> {
    pub(crate) const EMPTY: Self = Self {
        rows: [0.0; ROWS],
        last_actions: [0; ENTITIES],
        available: [0; ACTIONS],
        visible: [0; 2],
        own: 0,
    };

    /// Entities that are visible.
    #[unsafe(link_section = ".harness")]
    pub(crate) fn visible(&self) -> usize {
        EntityMask::from_words(&self.visible).len()
    }
}

/// The file, behind what was read.
pub(crate) struct Recording {
    file: File,
    features: usize,
    actions: usize,
    /// Frames that are still to be read.
    frames: u32,
    frame: Frame,
}

/// What all agents of a frame share, and how many of them are still to be read.
struct Frame {
    floats: usize,
    agents: usize,
    observations: u16,
}

impl Recording {
    /// Observations with these columns.
    #[unsafe(link_section = ".harness")]
    pub(crate) fn open(file: File, features: usize, actions: usize) -> Option<Self> {
        let mut header = [0_u32; 10];
        file.read(header.as_mut_bytes())?;
        let [_, _, version, _, _, _, d, u, frames, _] = header;
        let fits = version == 1 && (d as usize, u as usize) == (features, actions);
        let frame = Frame { floats: 0, agents: 0, observations: 0 };
        fits.then_some(Self { file, features, actions, frames, frame })
    }

    /// Reads the next observation; false behind the last, nothing where the file ends too early or a frame has no room.
    #[unsafe(link_section = ".harness")]
    #[inline(never)]
    pub(crate) fn next<const ROWS: usize, const ENTITIES: usize, const ACTIONS: usize>(
        &mut self,
        room: &mut Room<ROWS, ENTITIES, ACTIONS>,
    ) -> Option<bool> {
        while self.frame.observations == 0 {
            if self.frames == 0 {
                return Some(false);
            }
            self.frames -= 1;
            self.next_frame(&mut room.rows, &mut room.last_actions)?;
        }
        self.frame.observations -= 1;
        self.file.read(room.own.as_mut_bytes())?;
        self.file.read(room.available.get_mut(..self.actions)?.as_mut_bytes())?;
        self.file.read(room.visible.as_mut_bytes())?;
        Some(true)
    }

    /// Reads what the agents of the next frame share.
    #[unsafe(link_section = ".harness")]
    fn next_frame(&mut self, rows: &mut [f32], last_actions: &mut [u16]) -> Option<()> {
        let mut sizes = [0_u16; 4];
        self.file.read(sizes.as_mut_bytes())?;
        let [entities, agents, observations, _] = sizes;
        let (floats, agents) = (usize::from(entities) * self.features, usize::from(agents));
        self.file.read(rows.get_mut(..floats)?.as_mut_bytes())?;
        self.file.read(last_actions.get_mut(..agents)?.as_mut_bytes())?;
        self.frame = Frame { floats, agents, observations };
        Some(())
    }

    /// The observation that was read.
    #[inline(always)]
    pub(crate) fn observation<
        'r,
        const ROWS: usize,
        const ENTITIES: usize,
        const ACTIONS: usize,
    >(
        &self,
        room: &'r Room<ROWS, ENTITIES, ACTIONS>,
    ) -> Option<Observation<'r>> {
        Some(Observation {
            rows: room.rows.get(..self.frame.floats)?,
            stride: self.features,
            last_actions: room.last_actions.get(..self.frame.agents)?,
            visible: EntityMask::from_words(&room.visible),
            self_index: room.own.into(),
            available: &room.available,
        })
    }
}
