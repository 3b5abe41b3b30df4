//! Rules that say who goes where next, and what agents do that follow one.

use super::observation::Layout;
use super::tour::Tour;
use crate::decisions::UNASSIGNED;
use crate::spec::Rule;

pub(super) const RULES: &[Rule] = &[
    Rule {
        name: "nearest",
        about: "one vehicle at a time goes to the nearest customer that fits, and home when none does",
    },
    Rule {
        name: "greedy",
        about: "every vehicle goes to the nearest customer that fits and nobody before it goes to, and home when none is left for it",
    },
];

/// Writes what each vehicle heads for.
pub(super) fn allocate(rule: usize, tour: &Tour, layout: Layout, allocation: &mut [u8]) {
    allocation.fill(UNASSIGNED);
    let goals = &mut allocation[..layout.vehicles];
    if rule == 0 { nearest(tour, layout, goals) } else { greedy(tour, layout, goals) }
}

/// The nearest of the customers that a vehicle may go to, and nobody goes to by now.
fn nearest_free(tour: &Tour, layout: Layout, vehicle: usize, goals: &[u8]) -> Option<usize> {
    let is_free = |place: &usize| !goals.contains(&(layout.task_of(*place) as u8));
    let may = |place: &usize| tour.may_go(vehicle, *place, layout.sequential);
    let way = |place: &usize| tour.way(vehicle, *place);
    tour.waiting()
        .filter(|place| is_free(place) && may(place))
        .min_by(|one, other| way(one).total_cmp(&way(other)))
}

fn nearest(tour: &Tour, layout: Layout, goals: &mut [u8]) {
    // Whoever is outside goes on; at first the lowest leaves.
    let is_out = |vehicle: &usize| tour.vehicles[*vehicle].at != 0;
    let vehicle = (0..goals.len()).find(is_out).unwrap_or(0);
    let place = nearest_free(tour, layout, vehicle, &[]).unwrap_or(0);
    goals[vehicle] = layout.task_of(place) as u8;
}

fn greedy(tour: &Tour, layout: Layout, goals: &mut [u8]) {
    for vehicle in 0..goals.len() {
        let is_left = |place: usize| !goals.contains(&(layout.task_of(place) as u8));
        let place = match nearest_free(tour, layout, vehicle, goals) {
            Some(place) => place,
            None if tour.waiting().any(is_left) && tour.vehicles[vehicle].at != 0 => 0,
            None => continue,
        };
        goals[vehicle] = layout.task_of(place) as u8;
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
