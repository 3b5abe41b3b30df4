//! Recorded observations, read one after the other: `docs/recorded-observations.md` has the format.

use sortie_core::{EntityMask, Observation};
use zerocopy::IntoBytes;

use crate::file::File;

/// Room for what one agent sees: `ROWS` floats of features, `ENTITIES` rows, `ACTIONS` actions.
pub(crate) struct Room<const ROWS: usize, const ENTITIES: usize, const ACTIONS: usize> {
    rows: [f32; ROWS],
    last_actions: [u16; ENTITIES],
    available: [u16; ACTIONS],
}

impl<const ROWS: usize, const ENTITIES: usize, const ACTIONS: usize> Room<ROWS, ENTITIES, ACTIONS> {
    pub(crate) const EMPTY: Self =
        Self { rows: [0.0; ROWS], last_actions: [0; ENTITIES], available: [0; ACTIONS] };
}

/// The file, behind its header.
pub(crate) struct Recording {
    file: File,
    features: usize,
    /// Frames that are still to be read.
    frames: u32,
}

/// What all agents of a frame share, and how many of them observe.
struct Frame {
    floats: usize,
    agents: usize,
    observations: u16,
}

impl Recording {
    /// Opens a file of observations with these columns.
    #[unsafe(link_section = ".harness")]
    pub(crate) fn open(name: &[u8], features: usize, actions: usize) -> Option<Self> {
        let file = File::open(name)?;
        let mut header = [0_u32; 10];
        file.read(header.as_mut_bytes())?;
        let [_, _, version, _, _, _, d, u, frames, _] = header;
        let fits = version == 1 && (d as usize, u as usize) == (features, actions);
        fits.then_some(Self { file, features, frames })
    }

    /// Shows `see` every observation; nothing where the file ends too early, or a frame has no room.
    #[inline(always)]
    pub(crate) fn for_each<const ROWS: usize, const ENTITIES: usize, const ACTIONS: usize>(
        &mut self,
        room: &mut Room<ROWS, ENTITIES, ACTIONS>,
        mut see: impl FnMut(&Observation<'_>),
    ) -> Option<()> {
        for _ in 0..self.frames {
            let frame = self.frame(&mut room.rows, &mut room.last_actions)?;
            for _ in 0..frame.observations {
                let mut own = 0_u16;
                self.file.read(own.as_mut_bytes())?;
                self.file.read(room.available.as_mut_bytes())?;
                let mut visible = [0_u64; 2];
                self.file.read(visible.as_mut_bytes())?;
                see(&Observation {
                    rows: room.rows.get(..frame.floats)?,
                    stride: self.features,
                    last_actions: room.last_actions.get(..frame.agents)?,
                    visible: EntityMask::from_words(&visible),
                    self_index: own.into(),
                    available: &room.available,
                });
            }
        }
        Some(())
    }

    /// Reads what the agents of the next frame share.
    #[unsafe(link_section = ".harness")]
    fn frame(&mut self, rows: &mut [f32], last_actions: &mut [u16]) -> Option<Frame> {
        let mut sizes = [0_u16; 4];
        self.file.read(sizes.as_mut_bytes())?;
        let [entities, agents, observations, _] = sizes;
        let (floats, agents) = (usize::from(entities) * self.features, usize::from(agents));
        self.file.read(rows.get_mut(..floats)?.as_mut_bytes())?;
        self.file.read(last_actions.get_mut(..agents)?.as_mut_bytes())?;
        Some(Frame { floats, agents, observations })
    }
}
