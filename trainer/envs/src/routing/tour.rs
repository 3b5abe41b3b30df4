//! Rounds: who may go where, what a round does, and what it costs.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::instance::Instance;

/// The number of a place that is none.
pub(super) const NOWHERE: u8 = u8::MAX;

/// A vehicle between two rounds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Vehicle {
    /// The place where it is.
    pub(super) at: u8,
    /// What it has loaded since it left the depot.
    pub(super) load: u8,
    /// Times that it left the depot.
    pub(super) trips: u8,
}

/// Who served a customer, and from where it came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Visit {
    /// The vehicle; [`NOWHERE`] of a customer that waits.
    pub(super) vehicle: u8,
    pub(super) from: u8,
}

impl Visit {
    pub(super) const NONE: Self = Self { vehicle: NOWHERE, from: NOWHERE };

    pub(super) fn is_done(self) -> bool {
        self.vehicle != NOWHERE
    }
}

/// An episode: an instance, and how far it is served.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Tour {
    pub(super) instance: Instance,
    pub(super) vehicles: Vec<Vehicle>,
    /// By places; the depot is never served.
    pub(super) visits: Vec<Visit>,
    pub(super) rounds: u16,
    /// Rounds in which vehicles left the depot.
    pub(super) waves: u16,
    /// Rounds in which nobody moved by itself.
    pub(super) forced: u16,
    /// Of all routes so far.
    pub(super) length: f64,
    /// What each wave after the first costs besides, and all of them have.
    pub(super) wave_cost: f64,
    pub(super) costs: f64,
    /// Of the shortest routes, where that is known.
    pub(super) optimum: Option<f64>,
}

impl Tour {
    pub(super) fn new(instance: Instance, vehicles: usize, optimum: Option<f64>) -> Self {
        Self {
            vehicles: alloc::vec![Vehicle::default(); vehicles],
            visits: alloc::vec![Visit::NONE; instance.places.len()],
            instance,
            optimum,
            ..Self::default()
        }
    }

    /// The customers that wait, by their places.
    pub(super) fn waiting(&self) -> impl Iterator<Item = usize> {
        (1..self.visits.len()).filter(|place| !self.visits[*place].is_done())
    }

    pub(super) fn is_over(&self) -> bool {
        self.waiting().next().is_none()
    }

    /// What a vehicle can still load.
    pub(super) fn room(&self, vehicle: usize) -> u8 {
        self.instance.capacity - self.vehicles[vehicle].load
    }

    /// Times that vehicles have to leave the depot at least before all customers are served, if those that are outside load
    /// all that they have room for, but for one that goes home at once.
    pub(super) fn trips_to_come(&self, home: Option<usize>) -> u16 {
        let demand: u16 = self.waiting().map(|place| u16::from(self.instance.demands[place])).sum();
        let outside = (0..self.vehicles.len())
            .filter(|vehicle| self.is_out(*vehicle) && Some(*vehicle) != home);
        let room: u16 = outside.map(|vehicle| u16::from(self.room(vehicle))).sum();
        demand.saturating_sub(room).div_ceil(u16::from(self.instance.capacity))
    }

    /// How far it is from a vehicle to a place.
    pub(super) fn way(&self, vehicle: usize, place: usize) -> f64 {
        self.instance.distance(self.vehicles[vehicle].at.into(), place)
    }

    fn is_out(&self, vehicle: usize) -> bool {
        self.vehicles[vehicle].at != 0
    }

    /// Whether a vehicle may go to customers at all: one at the depot only together with all others, unless they go one by
    /// one.
    pub(super) fn may_serve(&self, vehicle: usize, sequential: bool) -> bool {
        sequential
            || self.is_out(vehicle)
            || (0..self.vehicles.len()).all(|other| !self.is_out(other))
    }

    /// Whether a vehicle may go to a place, whatever others do: to a customer that waits for no more than it has room for, or
    /// home.
    pub(super) fn may_go(&self, vehicle: usize, place: usize, sequential: bool) -> bool {
        match place {
            0 => self.is_out(vehicle),
            _ => {
                !self.visits[place].is_done()
                    && self.instance.demands[place] <= self.room(vehicle)
                    && self.may_serve(vehicle, sequential)
            }
        }
    }

    /// Moves all vehicles, see [`move_all`](Self::move_all): what the round costs.
    pub(super) fn round(&mut self, goals: &[Option<u8>], sequential: bool) -> f64 {
        let waves = self.waves;
        let way = self.move_all(goals, sequential);
        // Nothing in a length asks for few waves: left alone a learner has one vehicle leave in each.
        let cost = if self.waves > waves.max(1) { self.wave_cost } else { 0.0 };
        self.costs += cost;
        way + cost
    }

    /// Moves all vehicles to the places that they head for, all of which they [may](Self::may_go) go to. Of two that head for
    /// one customer the lower goes, the other one stays. When the last customer is served everybody goes home. Returns the
    /// way of all together.
    fn move_all(&mut self, goals: &[Option<u8>], sequential: bool) -> f64 {
        let mut goals: Vec<Option<u8>> = goals.to_vec();
        for vehicle in 1..goals.len() {
            let (before, own) = goals.split_at_mut(vehicle);
            own[0] = own[0].filter(|goal| *goal == 0 || !before.contains(&Some(*goal)));
        }
        if goals.iter().all(Option::is_none) {
            self.forced += 1;
            self.force(&mut goals, sequential);
        }
        let mut way = 0.0;
        let leaves = |(vehicle, goal): (&Vehicle, &Option<u8>)| goal.is_some() && vehicle.at == 0;
        self.waves += u16::from(self.vehicles.iter().zip(&goals).any(leaves));
        for (vehicle, goal) in goals.into_iter().enumerate() {
            if let Some(goal) = goal {
                way += self.go(vehicle, goal);
            }
        }
        self.rounds += 1;
        if self.is_over() {
            way += (0..self.vehicles.len()).map(|vehicle| self.go(vehicle, 0)).sum::<f64>();
        }
        self.length += way;
        way
    }

    /// Sends out whoever has the shortest way to a customer, or all home where nobody has one: no episode stands still.
    fn force(&self, goals: &mut [Option<u8>], sequential: bool) {
        let mut best: Option<(f64, usize, usize)> = None;
        for vehicle in 0..goals.len() {
            for place in self.waiting().filter(|place| self.may_go(vehicle, *place, sequential)) {
                let way = self.way(vehicle, place);
                if best.is_none_or(|(least, _, _)| way < least) {
                    best = Some((way, vehicle, place));
                }
            }
        }
        match best {
            Some((_, vehicle, place)) => goals[vehicle] = Some(place as u8),
            None => {
                let outside = (0..goals.len()).filter(|vehicle| self.is_out(*vehicle));
                outside.for_each(|vehicle| goals[vehicle] = Some(0));
            }
        }
    }

    fn go(&mut self, number: usize, goal: u8) -> f64 {
        let way = self.way(number, goal.into());
        let vehicle = &mut self.vehicles[number];
        if goal == 0 {
            (vehicle.at, vehicle.load) = (0, 0);
        } else {
            vehicle.trips += u8::from(vehicle.at == 0);
            self.visits[usize::from(goal)] = Visit { vehicle: number as u8, from: vehicle.at };
            vehicle.load += self.instance.demands[usize::from(goal)];
            vehicle.at = goal;
        }
        way
    }

    /// Whether an episode can have come to this.
    pub(super) fn is_sound(&self, vehicles: usize) -> bool {
        let places = self.instance.places.len();
        let served = self.visits.iter().filter(|visit| visit.is_done()).count();
        let is_place = |place: u8| usize::from(place) < places;
        let is_visit = |visit: &Visit| {
            *visit == Visit::NONE || usize::from(visit.vehicle) < vehicles && is_place(visit.from)
        };
        // Whoever leaves serves somebody, and every round serves somebody or brings somebody home.
        let is_vehicle = |vehicle: &Vehicle| {
            let at = usize::from(vehicle.at);
            vehicle.load <= self.instance.capacity
                && usize::from(vehicle.trips) <= served
                && is_place(vehicle.at)
                && (at == 0 && vehicle.load == 0 || at > 0 && self.visits[at].is_done())
        };
        self.instance.is_sound()
            && self.vehicles.len() == vehicles
            && self.visits.len() == places
            && self.visits.first() == Some(&Visit::NONE)
            && self.visits.iter().all(is_visit)
            && self.vehicles.iter().all(is_vehicle)
            && usize::from(self.rounds) <= 2 * served
            && self.waves.max(self.forced) <= self.rounds
            && (self.length + self.wave_cost + self.costs).is_finite()
            && self.optimum.is_none_or(|optimum| optimum.is_finite() && optimum > 0.0)
    }
}
