//! Encounters read back from feature rows, for rules of allocation in processes that see messages alone.

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::armies::ARMIES;
use super::observation::FIRST_ARMY;
use super::rules::Muster;
use super::units::TYPES;
use crate::decisions::UNASSIGNED;
use crate::frame::{Frame, FrameError, FrameReader};
use crate::observation::members;
use crate::random::Random;

/// A reader that has read nothing yet.
pub(super) fn reader() -> Box<dyn FrameReader> {
    Box::new(Reader::default())
}

/// What rules need of a frame. Rows do not show the dead, nor the order that an episode has drawn: here the living count, and
/// agents choose by their numbers.
#[derive(Debug, Default)]
struct Reader {
    muster: Muster,
    /// Agents that are there, and their types.
    agents: Vec<(usize, usize)>,
    /// Agent rows.
    slots: usize,
}

impl FrameReader for Reader {
    fn read(&mut self, frame: &Frame<'_>) -> Result<(), FrameError> {
        if frame.tasks > ARMIES {
            return Err(FrameError::TooLarge);
        }
        self.muster = Muster { open: frame.open_tasks & ((1 << ARMIES) - 1), ..Muster::default() };
        self.agents.clear();
        self.slots = frame.agents;
        for entity in members(frame.present) {
            let row = frame.rows.get(entity * frame.stride..).unwrap_or_default();
            let row = row.get(..frame.stride.min(FIRST_ARMY + ARMIES + 1));
            let row = row.ok_or(FrameError::BadLength)?;
            if !row.iter().all(|value| value.is_finite()) {
                return Err(FrameError::NonFinite { entity });
            }
            let marked = |first: usize, count: usize| {
                row.get(first..)?.iter().take(count).position(|value| *value == 1.0)
            };
            let kind = marked(1, TYPES).ok_or(FrameError::BadRow { entity })?;
            if entity < frame.agents {
                self.agents.push((entity, kind));
            } else if let Some(army) = marked(FIRST_ARMY, ARMIES) {
                self.muster.units[army][kind] += 1;
                self.muster.attacks[army] = row.get(FIRST_ARMY + ARMIES) == Some(&1.0);
            }
        }
        Ok(())
    }

    fn allocate(
        &mut self,
        rule: usize,
        random: &mut Random,
        allocation: &mut [u8],
    ) -> Result<(), FrameError> {
        if allocation.len() < self.slots {
            return Err(FrameError::BadLength);
        }
        allocation.fill(UNASSIGNED);
        self.muster.allocate(rule, self.agents.iter().copied(), random, allocation);
        Ok(())
    }

    fn relations(&self) -> usize {
        0
    }

    fn relate(&self, _: usize, _: &mut [f32]) {}
}
