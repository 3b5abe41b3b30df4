//! What there is to see: a row for each vehicle, customer and the depot, all of it seen by everybody.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::tour::Tour;
use crate::observation::{ActionSet, EntitySet, Observation, TaskSet, members};
use crate::rows::SparseRows;

pub(super) const FEATURES: [&str; 14] = [
    "vehicle",
    "customer",
    "depot",
    "x",
    "y",
    "distance to the depot",
    "demand",
    "load",
    "room",
    "at the depot",
    "served",
    "demand that waits",
    "trips to come",
    "trips to come after going home",
];
/// Columns of what rows show.
pub(super) const VEHICLE: usize = 0;
pub(super) const CUSTOMER: usize = 1;
pub(super) const DEPOT: usize = 2;
/// Y follows.
pub(super) const X: usize = 3;
pub(super) const DEMAND: usize = 6;
pub(super) const LOAD: usize = 7;
pub(super) const AT_DEPOT: usize = 9;
pub(super) const SERVED: usize = 10;
/// So many columns, the first ones, stay as they are: all that tells instances apart.
pub(super) const FIXED: usize = 7;
/// Most of them that differ from zero in one row: a vehicle's.
pub(super) const ROW_ENTRIES: usize = 10;
/// Symmetries of the square.
pub(super) const TURNS: usize = 8;

pub(super) fn feature_names() -> Vec<String> {
    FEATURES.map(String::from).to_vec()
}

/// Which entities there are, and which actions: vehicles, then customers, the depot last. An agent stays, or heads for one of
/// those that are no vehicles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) vehicles: usize,
    /// Most customers.
    pub(super) customers: usize,
    pub(super) sequential: bool,
}

impl Layout {
    pub(super) const STAY: u16 = 0;

    pub(super) fn entities(self) -> usize {
        self.vehicles + self.customers + 1
    }

    /// The depot's subtask, the last one; those of customers are before it.
    pub(super) fn task_of(self, place: usize) -> usize {
        place.checked_sub(1).unwrap_or(self.customers)
    }

    /// The place that a subtask is to go to.
    pub(super) fn place_of(self, task: usize) -> usize {
        if task == self.customers { 0 } else { task + 1 }
    }

    fn entity_of(self, place: usize) -> usize {
        self.vehicles + self.task_of(place)
    }

    pub(super) fn action_to(self, place: usize) -> u16 {
        1 + self.task_of(place) as u16
    }

    /// Where an action leads; nowhere who stays.
    pub(super) fn goal(self, action: u16) -> Option<u8> {
        let task = usize::from(action).checked_sub(1)?;
        Some(self.place_of(task) as u8)
    }

    pub(super) fn action_names(self) -> Vec<String> {
        let customers = (1..=self.customers).map(|customer| format!("customer-{customer}"));
        ["stay".to_string()].into_iter().chain(customers).chain(["depot".to_string()]).collect()
    }

    /// The actions that a vehicle may take, whatever the others do.
    pub(super) fn available(self, tour: &Tour, vehicle: usize) -> ActionSet {
        (0..tour.visits.len())
            .filter(|place| tour.may_go(vehicle, *place, self.sequential))
            .fold(1, |open, place| open | 1 << self.action_to(place))
    }

    /// The subtasks that a vehicle may head for, as bits.
    pub(super) fn offers(self, tour: &Tour, vehicle: usize) -> TaskSet {
        self.available(tour, vehicle) >> 1
    }

    pub(super) fn observe(
        self,
        tour: &Tour,
        turn: usize,
        wanted: EntitySet,
        seen: &mut Observation,
    ) {
        let (entities, places) = (self.entities(), tour.visits.len());
        seen.absent = 0;
        seen.present = (1 << self.vehicles) - 1;
        seen.entity_task.clear();
        seen.entity_task.resize(entities, 0);
        seen.open_tasks = 1 << self.task_of(0);
        for place in 0..places {
            let (entity, task) = (self.entity_of(place), self.task_of(place));
            seen.present |= 1 << entity;
            seen.entity_task[entity] = 1 << task;
            seen.open_tasks |= TaskSet::from(!tour.visits[place].is_done()) << task;
        }
        seen.entities = seen.present & wanted;
        seen.observable.clear();
        seen.observable.resize(self.vehicles, seen.present);
        seen.available.clear();
        seen.available.extend((0..self.vehicles).map(|vehicle| self.available(tour, vehicle)));
        seen.rows.clear();
        let shown = Shown { tour, turn, waiting: share_that_waits(tour) };
        for entity in members(seen.entities) {
            match entity.checked_sub(self.vehicles) {
                None => shown.write_vehicle(entity, &mut seen.rows),
                Some(task) => shown.write_place(self.place_of(task), &mut seen.rows),
            }
            seen.rows.end_row();
        }
    }
}

/// A place as a symmetry of the square shows it: four rotations, then those of its mirror image.
///
/// The half turn comes first: under it, whoever goes over the square one way goes the other way, so that few courses by the
/// first two are long both times.
fn turned([x, y]: [f64; 2], turn: usize) -> [f64; 2] {
    let is = |bit: usize| turn & bit == bit;
    let mirrored = if is(4) { 1.0 - x } else { x };
    let [x, y] = if is(2) { [1.0 - y, mirrored] } else { [mirrored, y] };
    if is(1) { [1.0 - x, 1.0 - y] } else { [x, y] }
}

/// The share of all demands that waits.
fn share_that_waits(tour: &Tour) -> f32 {
    let demand = |place: usize| f32::from(tour.instance.demands[place]);
    let all: f32 = (0..tour.visits.len()).map(demand).sum();
    tour.waiting().map(demand).sum::<f32>() / all
}

/// A tour whose rows are written.
struct Shown<'a> {
    tour: &'a Tour,
    turn: usize,
    waiting: f32,
}

impl Shown<'_> {
    fn write_vehicle(&self, number: usize, rows: &mut SparseRows) {
        let tour = self.tour;
        let (vehicle, capacity) = (tour.vehicles[number], f32::from(tour.instance.capacity));
        self.write_where((VEHICLE, vehicle.at.into()), rows);
        rows.push_unless_zero(LOAD, f32::from(vehicle.load) / capacity);
        rows.push_unless_zero(8, f32::from(tour.room(number)) / capacity);
        rows.push_unless_zero(AT_DEPOT, f32::from(u8::from(vehicle.at == 0)));
        rows.push_unless_zero(11, self.waiting);
        rows.push_unless_zero(12, f32::from(tour.trips_to_come(None)));
        rows.push_unless_zero(13, f32::from(tour.trips_to_come(Some(number))));
    }

    fn write_place(&self, place: usize, rows: &mut SparseRows) {
        let tour = self.tour;
        let kind = if place == 0 { DEPOT } else { CUSTOMER };
        self.write_where((kind, place), rows);
        let demand = f32::from(tour.instance.demands[place]) / f32::from(tour.instance.capacity);
        rows.push_unless_zero(DEMAND, demand);
        rows.push_unless_zero(SERVED, f32::from(u8::from(tour.visits[place].is_done())));
        rows.push_unless_zero(11, self.waiting);
    }

    /// The columns that every row has: its kind, and where it is.
    fn write_where(&self, (kind, place): (usize, usize), rows: &mut SparseRows) {
        let [x, y] = turned(self.tour.instance.places[place], self.turn);
        rows.push(kind, 1.0);
        rows.push_unless_zero(X, x as f32);
        rows.push_unless_zero(X + 1, y as f32);
        rows.push_unless_zero(5, self.tour.instance.distance(place, 0) as f32);
    }
}
