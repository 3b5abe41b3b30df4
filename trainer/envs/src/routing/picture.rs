//! What a tour looks like: places, vehicles, the legs that were driven.

use alloc::format;
use alloc::string::ToString;
use alloc::vec::Vec;

use super::observation::Layout;
use super::tour::Tour;
use crate::picture::{Bar, Disc, Field, Link, Outline, Picture};

/// Discs of places, in parts of the square.
const RADIUS: f64 = 0.018;

pub(super) fn picture(tour: &Tour, layout: Layout) -> Picture {
    let instance = &tour.instance;
    let capacity = f64::from(instance.capacity);
    let agents = tour.vehicles.iter().enumerate().map(|(number, vehicle)| {
        let at = usize::from(vehicle.at);
        Disc {
            name: number.to_string(),
            kind: "vehicle",
            outline: Outline::Triangle,
            colour: Some(number as u8),
            place: Some(instance.places[at]),
            radius: Some(RADIUS * 1.2),
            bars: [Bar { name: "load", share: f64::from(vehicle.load) / capacity }].into(),
            status: if at == 0 { "at the depot".into() } else { format!("at customer {at}") },
            about: format!(
                "{} of {} loaded, trip {}",
                vehicle.load, instance.capacity, vehicle.trips
            ),
            ..Disc::default()
        }
    });
    let customers = (1..instance.places.len()).map(|place| {
        let visit = tour.visits[place];
        Disc {
            name: place.to_string(),
            kind: "customer",
            colour: visit.is_done().then_some(visit.vehicle),
            place: Some(instance.places[place]),
            radius: Some(RADIUS),
            status: if visit.is_done() {
                format!("served by {}", visit.vehicle)
            } else {
                "waits".into()
            },
            about: format!("asks for {}", instance.demands[place]),
            task: Some(layout.task_of(place)),
            ..Disc::default()
        }
    });
    let optimum = tour.optimum.map(|optimum| format!(", the shortest routes {optimum:.3}"));
    let depot = Disc {
        name: "depot".into(),
        label: "D".into(),
        kind: "depot",
        outline: Outline::Square,
        place: instance.places.first().copied(),
        radius: Some(RADIUS * 1.2),
        about: format!(
            "driven {:.3}{}, wave {}",
            tour.length,
            optimum.unwrap_or_default(),
            tour.waves
        ),
        task: Some(layout.task_of(0)),
        ..Disc::default()
    };
    // Things are counted without gaps: customers in their order, then the depot.
    let number = |place: usize| match place {
        0 => layout.vehicles + instance.customers(),
        place => layout.vehicles + place - 1,
    };
    let legs =
        (1..instance.places.len()).filter(|place| tour.visits[*place].is_done()).map(|place| {
            let from = usize::from(tour.visits[place].from);
            Link { name: "leg", from: number(from), to: number(place) }
        });
    Picture {
        field: Some(Field { from: [-0.04, 1.04], to: [1.04, -0.04], cell: 0.05, is_grid: false }),
        cells: Vec::new(),
        agents: agents.collect(),
        things: customers.chain([depot]).collect(),
        links: legs.collect(),
    }
}
