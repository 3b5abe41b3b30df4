//! Rules that say who goes where next, and what agents do that follow one.

use alloc::vec::Vec;

use sortie_core::allocate::{Teams, cost};
use sortie_core::limits::TASKS;

use super::instance::distance;
use super::observation::Layout;
use super::tour::Tour;
use crate::decisions::UNASSIGNED;
use crate::observation::TaskSet;
use crate::spec::Rule;

pub(super) const RULES: &[Rule] = &[
    Rule::new(
        "nearest",
        "one vehicle at a time goes to the nearest customer that fits, and home when none does",
    ),
    Rule::new(
        "greedy",
        "every vehicle goes to the nearest customer that fits and nobody before it goes to, and home when none is left for it",
    ),
    Rule::new(
        "hungarian",
        "as many vehicles as can go to customers at once, by the shortest ways of all together, and home when none is left",
    ),
];

/// What rules look at: whoever there is, and where they may go.
#[derive(Clone, Debug, Default)]
pub(super) struct Scene {
    /// By their agents.
    pub(super) vehicles: Vec<Standing>,
    /// Customers that wait, by their subtasks, and where they are.
    pub(super) waiting: Vec<(u8, [f64; 2])>,
    /// The subtask of going home.
    pub(super) depot: u8,
}

/// A vehicle that waits for what it is to do.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Standing {
    pub(super) at: [f64; 2],
    pub(super) is_out: bool,
    /// Subtasks that it may head for, as bits; none of a vehicle that is not there.
    pub(super) offers: TaskSet,
}

impl Scene {
    pub(super) fn of(tour: &Tour, layout: Layout) -> Self {
        let place = |place: usize| tour.instance.places[place];
        let standing = |vehicle: usize| {
            let at = usize::from(tour.vehicles[vehicle].at);
            Standing { at: place(at), is_out: at != 0, offers: layout.offers(tour, vehicle) }
        };
        Self {
            vehicles: (0..layout.vehicles).map(standing).collect(),
            waiting: tour.waiting().map(|at| (layout.task_of(at) as u8, place(at))).collect(),
            depot: layout.task_of(0) as u8,
        }
    }

    /// Writes what each vehicle heads for.
    pub(super) fn allocate(&self, rule: usize, allocation: &mut [u8]) {
        allocation.fill(UNASSIGNED);
        match rule {
            0 => self.nearest(allocation),
            1 => self.greedy(allocation),
            _ => self.hungarian(allocation),
        }
    }

    /// The nearest of the customers that a vehicle may go to, and nobody goes to by now.
    fn nearest_free(&self, vehicle: Standing, goals: &[u8]) -> Option<u8> {
        let free =
            self.waiting.iter().filter(|(task, _)| vehicle.may(*task) && !goals.contains(task));
        let way = |at: [f64; 2]| distance(vehicle.at, at);
        free.min_by(|one, other| way(one.1).total_cmp(&way(other.1))).map(|(task, _)| *task)
    }

    fn nearest(&self, goals: &mut [u8]) {
        // Whoever is outside goes on; at first the lowest leaves.
        let find = |is_meant: fn(&Standing) -> bool| self.vehicles.iter().position(is_meant);
        let goes_on = find(|vehicle| vehicle.is_out && vehicle.offers != 0);
        if let Some(vehicle) = goes_on.or_else(|| find(|vehicle| vehicle.offers != 0)) {
            let nearest = self.nearest_free(self.vehicles[vehicle], &[]);
            goals[vehicle] = nearest.unwrap_or(self.depot);
        }
    }

    fn greedy(&self, goals: &mut [u8]) {
        for (vehicle, standing) in self.vehicles.iter().enumerate() {
            match self.nearest_free(*standing, goals) {
                Some(task) => goals[vehicle] = task,
                None => self.send_home(vehicle, goals),
            }
        }
    }

    fn hungarian(&self, goals: &mut [u8]) {
        let (agents, near) = (self.vehicles.len(), self.near());
        let mut ways = alloc::vec![f32::INFINITY; agents * near.len()];
        for (vehicle, ways) in self.vehicles.iter().zip(ways.chunks_exact_mut(near.len().max(1))) {
            for ((_, at), way) in near.iter().zip(ways).filter(|((task, _), _)| vehicle.may(*task))
            {
                *way = distance(vehicle.at, *at) as f32;
            }
        }
        let open_tasks = (0..near.len()).fold(0, |open, column| open | 1 << column);
        let teams = Teams { agents, open_tasks, team_max: 1 };
        // It refuses more agents than there can be, and numbers that do not fit each other: then nobody leaves.
        let _ = cost::hungarian(teams, near.len(), &ways, &mut goals[..agents]);
        for goal in &mut goals[..agents] {
            *goal = near.get(usize::from(*goal)).map_or(UNASSIGNED, |(task, _)| *task);
        }
        for vehicle in 0..agents {
            if goals[vehicle] == UNASSIGNED {
                self.send_home(vehicle, goals);
            }
        }
    }

    /// Customers that wait, by their numbers; no more than there is room for, those with the shortest ways to anybody.
    fn near(&self) -> Vec<(u8, [f64; 2])> {
        let mut near = self.waiting.clone();
        if near.len() > TASKS {
            let ways = |at| self.vehicles.iter().map(move |vehicle| distance(vehicle.at, at));
            let way = |at| ways(at).fold(f64::INFINITY, f64::min);
            near.sort_by(|one, other| way(one.1).total_cmp(&way(other.1)));
            near.truncate(TASKS);
            near.sort_by_key(|(task, _)| *task);
        }
        near
    }

    /// Who is outside goes home while there are customers that nobody goes to: the last ones bring everybody home.
    fn send_home(&self, vehicle: usize, goals: &mut [u8]) {
        let is_left = self.waiting.iter().any(|(task, _)| !goals.contains(task));
        if is_left && self.vehicles[vehicle].is_out && self.vehicles[vehicle].may(self.depot) {
            goals[vehicle] = self.depot;
        }
    }
}

impl Standing {
    fn may(self, task: u8) -> bool {
        self.offers >> task & 1 == 1
    }
}

/// Heads for the places of an allocation. Whoever has none, or may not go there, stays.
pub(super) fn follow(tour: &Tour, layout: Layout, allocation: &[u8], actions: &mut [u16]) {
    for (vehicle, (task, action)) in allocation.iter().zip(actions).enumerate() {
        let task = usize::from(*task);
        let action_there =
            (task <= layout.customers).then(|| layout.action_to(layout.place_of(task)));
        let available = layout.available(tour, vehicle);
        let may = |there: &u16| available >> there & 1 == 1;
        *action = action_there.filter(may).unwrap_or(Layout::STAY);
    }
}
