//! What is worth jumping to in an episode.

use alloc::format;
use alloc::vec::Vec;

use sortie_envs::particle::Point;

use super::data::{Event, EventKind, Facts};
use super::{Plane, kind_name};
use crate::names::lettered;
use crate::show::Shown;

/// Agents of these roles lose by touching each other.
const BUMPING: [&str; 2] = ["collector", "agent"];

/// The events that show in a state behind another.
pub(super) fn events(
    facts: &Facts,
    at: usize,
    before: &Shown<Plane>,
    now: &Shown<Plane>,
) -> Vec<Event> {
    let mut events = Vec::new();
    let mut add = |kind, of, text| events.push(Event { at, kind, of, text });
    for (agent, own) in facts.agents.iter().enumerate() {
        match (before.state.holds[agent], now.state.holds[agent]) {
            (None, Some(kind)) => {
                add(EventKind::Taken, agent, format!("{agent} takes {}", kind_name(kind)));
            }
            (Some(kind), None) => {
                let text = format!("{agent} brings {} to its bank", kind_name(kind));
                add(EventKind::Delivered, agent, text);
            }
            _ => {}
        }
        // Near its goal a rover earns, elsewhere it loses.
        let near = |shown: &Shown<Plane>| {
            shown.step.as_ref().is_some_and(|step| step.rewards[agent] > 0.0)
        };
        if let (Some(goal), Some(_)) = (own.goal, own.radius)
            && near(now)
            && !near(before)
        {
            add(EventKind::Near, agent, format!("{agent} is near {}", lettered(goal)));
        }
        for (other, its) in facts.agents[..agent].iter().enumerate() {
            let (Some(one), Some(another)) = (its.radius, own.radius) else { continue };
            let touch = |shown: &Shown<Plane>| {
                let [from, to] = [other, agent].map(|it| shown.state.places[it]);
                distance(from, to) < one + another
            };
            let bump = [its, own].iter().all(|it| BUMPING.contains(&it.role));
            if bump && touch(now) && !touch(before) {
                add(EventKind::Touch, agent, format!("{other} and {agent} touch"));
            }
        }
    }
    events
}

fn distance(one: Option<Point>, other: Option<Point>) -> f64 {
    let (Some(one), Some(other)) = (one, other) else { return f64::INFINITY };
    libm::hypot(one[0] - other[0], one[1] - other[1])
}
