//! Tours read back from feature rows, for rules of allocation in processes that see messages alone.

use alloc::boxed::Box;

use sortie_core::limits::TASKS;

use super::observation::{AT_DEPOT, CUSTOMER, DEPOT, FEATURES, VEHICLE, X};
use super::rules::{Scene, Standing};
use crate::decisions::UNASSIGNED;
use crate::frame::{Frame, FrameError, FrameReader};
use crate::observation::members;
use crate::random::Random;

/// A reader that has read nothing yet.
pub(super) fn reader() -> Box<dyn FrameReader> {
    Box::new(Reader::default())
}

/// What rules need of frames.
#[derive(Debug, Default)]
struct Reader {
    scene: Scene,
}

impl FrameReader for Reader {
    fn read(&mut self, frame: &Frame<'_>) -> Result<(), FrameError> {
        let Frame { agents, tasks, available, .. } = *frame;
        if tasks > TASKS {
            return Err(FrameError::TooLarge);
        }
        // To stay, and to head for each subtask.
        if available.len() != agents * (1 + tasks) {
            return Err(FrameError::BadLength);
        }
        // Should no row show the depot, it is the last subtask, as everywhere.
        let depot = tasks.saturating_sub(1) as u8;
        let vehicles = alloc::vec![Standing::default(); agents];
        self.scene = Scene { vehicles, depot, tasks, ..Scene::default() };
        for entity in members(frame.present) {
            let row = row(frame, entity)?;
            let at = [f64::from(row[X]), f64::from(row[X + 1])];
            let is = |kind: usize| row[kind] == 1.0;
            let Some(task) = entity.checked_sub(agents) else {
                if !is(VEHICLE) {
                    return Err(FrameError::BadRow { entity });
                }
                let heading = available[entity * (1 + tasks)..].iter().skip(1).take(tasks);
                let offers = heading.rev().fold(0, |all, one| all << 1 | u32::from(*one != 0));
                self.scene.vehicles[entity] = Standing { at, is_out: !is(AT_DEPOT), offers };
                continue;
            };
            if task >= tasks || !(is(CUSTOMER) || is(DEPOT)) {
                return Err(FrameError::BadRow { entity });
            }
            if is(DEPOT) {
                self.scene.depot = task as u8;
            } else if frame.open_tasks >> task & 1 == 1 {
                self.scene.waiting.push((task as u8, at));
            }
        }
        Ok(())
    }

    fn allocate(
        &mut self,
        rule: usize,
        _: &mut Random,
        allocation: &mut [u8],
    ) -> Result<(), FrameError> {
        let agents = self.scene.vehicles.len();
        allocation.fill(UNASSIGNED);
        let goals = allocation.get_mut(..agents).ok_or(FrameError::BadLength)?;
        self.scene.allocate(rule, goals);
        Ok(())
    }

    fn relations(&self) -> usize {
        0
    }

    fn relate(&self, _: usize, _: &mut [f32]) {}
}

/// The features of an entity.
fn row<'a>(frame: &Frame<'a>, entity: usize) -> Result<&'a [f32], FrameError> {
    let row = frame.rows.get(entity * frame.stride..).unwrap_or_default();
    let row = row.get(..frame.stride.min(FEATURES.len())).ok_or(FrameError::BadLength)?;
    if row.len() < FEATURES.len() {
        return Err(FrameError::BadLength);
    }
    let is_finite = row.iter().all(|value| value.is_finite());
    is_finite.then_some(row).ok_or(FrameError::NonFinite { entity })
}
