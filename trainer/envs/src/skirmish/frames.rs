//! Encounters read back from feature rows, for rules of allocation in processes that see messages alone.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use super::armies::ARMIES;
use super::observation::{BODY, FIRST_ARMY, PLACE};
use super::relations::{Glimpse, Opposed, RELATIONS};
use super::rules::Muster;
use super::units::TYPES;
use crate::decisions::UNASSIGNED;
use crate::frame::{Frame, FrameError, FrameReader};
use crate::observation::{EntitySet, members};
use crate::random::Random;

/// A reader that has read nothing yet.
pub(super) fn reader() -> Box<dyn FrameReader> {
    Box::new(Reader::default())
}

/// A unit as rows show it: its type, and the army of an enemy.
type Shown = (usize, Option<usize>);

/// What rules need of frames. Rows do not show the dead, who count: they are remembered until a frame shows somebody who was
/// not there before, or somebody else in a unit's place, as that is another episode. Nor do rows tell the order that an episode
/// has drawn: here agents choose by their numbers.
#[derive(Debug, Default)]
struct Reader {
    /// Units of the episode, by their rows.
    units: BTreeMap<usize, Shown>,
    /// Those that live.
    present: EntitySet,
    /// How these stand, by their rows.
    glimpses: Vec<(usize, Glimpse)>,
    muster: Muster,
    /// Agent rows.
    slots: usize,
}

impl FrameReader for Reader {
    fn read(&mut self, frame: &Frame<'_>) -> Result<(), FrameError> {
        if frame.tasks > ARMIES {
            return Err(FrameError::TooLarge);
        }
        let shown = members(frame.present).map(|entity| Ok((entity, shown(frame, entity)?)));
        let shown = shown.collect::<Result<Vec<_>, FrameError>>()?;
        let is_known = |(entity, unit): &(usize, Shown)| self.units.get(entity) == Some(unit);
        if frame.present & !self.present != 0 || !shown.iter().all(is_known) {
            self.units.clear();
        }
        self.units.extend(shown);
        (self.present, self.slots) = (frame.present, frame.agents);
        self.muster = Muster { open: frame.open_tasks & ((1 << ARMIES) - 1), ..Muster::default() };
        for (entity, (kind, army)) in &self.units {
            let Some(army) = *army else { continue };
            self.muster.units[army][*kind] += 1;
            let attacks = frame.rows.get(entity * frame.stride + FIRST_ARMY + ARMIES);
            self.muster.attacks[army] |= frame.present >> entity & 1 == 1 && attacks == Some(&1.0);
        }
        let seen = members(frame.present)
            .filter_map(|entity| Some((entity, self.glimpse(frame, entity)?)));
        self.glimpses = seen.collect();
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
        let agents = self.units.range(..self.slots).map(|(agent, (kind, _))| (*agent, *kind));
        self.muster.allocate(rule, agents, random, allocation);
        let lives = |agent: &usize| self.present >> agent & 1 == 1;
        (0..self.slots)
            .filter(|agent| !lives(agent))
            .for_each(|dead| allocation[dead] = UNASSIGNED);
        Ok(())
    }

    fn relations(&self) -> usize {
        RELATIONS
    }

    fn relate(&self, task: usize, relation: &mut [f32]) {
        relation.fill(0.0);
        let Some(opposed) = Opposed::of(self.glimpses.iter().copied(), task) else { return };
        for (entity, unit) in &self.glimpses {
            if let Some(columns) = relation.chunks_exact_mut(RELATIONS).nth(*entity) {
                columns.copy_from_slice(&opposed.relation(*entity, unit));
            }
        }
    }
}

impl Reader {
    /// What a row shows of a unit; none of the dead, whose rows say no more than their types.
    fn glimpse(&self, frame: &Frame<'_>, entity: usize) -> Option<Glimpse> {
        let row = frame.rows.get(entity * frame.stride..)?;
        let told = |column: usize| row.get(column).copied().unwrap_or_default();
        let [health, shield] = BODY.map(told);
        let army = self.units.get(&entity).and_then(|(_, army)| *army);
        (health > 0.0).then(|| Glimpse { army, place: PLACE.map(told), body: health + shield })
    }
}

/// What the row of a unit shows.
fn shown(frame: &Frame<'_>, entity: usize) -> Result<Shown, FrameError> {
    let row = frame.rows.get(entity * frame.stride..).unwrap_or_default();
    let row = row.get(..frame.stride.min(FIRST_ARMY + ARMIES + 1)).ok_or(FrameError::BadLength)?;
    if !row.iter().all(|value| value.is_finite()) {
        return Err(FrameError::NonFinite { entity });
    }
    let marked = |first: usize, count: usize| {
        row.get(first..)?.iter().take(count).position(|value| *value == 1.0)
    };
    let kind = marked(1, TYPES).ok_or(FrameError::BadRow { entity })?;
    Ok((kind, marked(FIRST_ARMY, ARMIES).filter(|_| entity >= frame.agents)))
}
