//! Rules that say who goes where next, and what agents do that follow one.

use alloc::vec::Vec;

use sortie_core::allocate::{Teams, cost};

use super::instance::distance;
use super::observation::Layout;
use super::tour::Tour;
use crate::decisions::UNASSIGNED;
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
    /// Number of subtasks, of which all those above are.
    pub(super) tasks: usize,
}

/// A vehicle that waits for what it is to do.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Standing {
    pub(super) at: [f64; 2],
    pub(super) is_out: bool,
    /// Subtasks that it may head for, as bits; none of a vehicle that is not there.
    pub(super) offers: u32,
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
            tasks: layout.customers + 1,
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
        let (agents, tasks) = (self.vehicles.len(), self.tasks);
        let mut ways = alloc::vec![f32::INFINITY; agents * tasks];
        for (vehicle, ways) in self.vehicles.iter().zip(ways.chunks_exact_mut(tasks.max(1))) {
            for (task, at) in self.waiting.iter().filter(|(task, _)| vehicle.may(*task)) {
                ways[usize::from(*task)] = distance(vehicle.at, *at) as f32;
            }
        }
        let open_tasks = self.waiting.iter().fold(0, |open, (task, _)| open | 1 << task);
        let teams = Teams { agents, open_tasks, team_max: 1 };
        // It refuses more agents than there can be, and numbers that do not fit each other: then nobody leaves.
        let _ = cost::hungarian(teams, tasks, &ways, &mut goals[..agents]);
        for vehicle in 0..agents {
            if goals[vehicle] == UNASSIGNED {
                self.send_home(vehicle, goals);
            }
        }
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
