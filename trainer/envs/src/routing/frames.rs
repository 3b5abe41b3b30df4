//! Tours read back from feature rows, for rules of allocation in processes that see messages alone.

use alloc::boxed::Box;

use sortie_core::limits::TASKS;

use super::instance::Instance;
use super::observation::{
    AT_DEPOT, CUSTOMER, DEMAND, DEPOT, FEATURES, LOAD, Layout, SERVED, VEHICLE, X,
};
use super::rules::{Scene, Standing};
use super::tour::{Tour, Vehicle, Visit};
use crate::decisions::UNASSIGNED;
use crate::frame::{Frame, FrameError, FrameReader};
use crate::observation::{TaskSet, members};
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
        self.scene = Scene { vehicles, depot, ..Scene::default() };
        for entity in members(frame.present) {
            let row = row(frame, entity)?;
            let at = [f64::from(row[X]), f64::from(row[X + 1])];
            let is = |kind: usize| row[kind] == 1.0;
            let Some(task) = entity.checked_sub(agents) else {
                if !is(VEHICLE) {
                    return Err(FrameError::BadRow { entity });
                }
                let heading = available[entity * (1 + tasks)..].iter().skip(1).take(tasks);
                let offers = heading.rev().fold(0, |all, one| all << 1 | TaskSet::from(*one != 0));
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

/// The tour that a frame shows, of vehicles that hold so much and are all there; how it came to this is not told. Customers are
/// counted as they come, whatever the numbers of their rows.
pub(super) fn rebuilt(frame: &Frame<'_>, layout: Layout, capacity: u8) -> Option<Tour> {
    if (frame.agents, frame.tasks) != (layout.vehicles, layout.customers + 1) {
        return None;
    }
    let place = |row: &[f32]| [f64::from(row[X]), f64::from(row[X + 1])];
    let count = |share: f32| (share * f32::from(capacity) + 0.5) as u8;
    let (mut depot, mut places, mut demands) = (None, alloc::vec![[0.0; 2]], alloc::vec![0]);
    let mut visits = alloc::vec![Visit::NONE];
    for entity in members(frame.present).skip_while(|entity| *entity < frame.agents) {
        let row = row(frame, entity).ok()?;
        if row[DEPOT] == 1.0 {
            depot = Some(place(row));
            continue;
        }
        places.push(place(row));
        demands.push(count(row[DEMAND]));
        // By whom it was served, and from where, is of no consequence.
        let is_served = row[SERVED] == 1.0;
        visits.push(if is_served { Visit { vehicle: 0, from: 0 } } else { Visit::NONE });
    }
    places[0] = depot?;
    let vehicle = |vehicle: usize| {
        let row = row(frame, vehicle).ok().filter(|_| frame.present >> vehicle & 1 == 1)?;
        let is_there = |at: &usize| visits[*at].is_done() && places[*at] == place(row);
        let at = if row[AT_DEPOT] == 1.0 { 0 } else { (1..places.len()).find(is_there)? };
        Some(Vehicle { at: at as u8, load: count(row[LOAD]), trips: 0 })
    };
    let vehicles = (0..frame.agents).map(vehicle).collect::<Option<_>>()?;
    let instance = Instance { places, demands, capacity };
    Some(Tour { instance, vehicles, visits, ..Tour::default() })
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
