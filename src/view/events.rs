//! What is worth jumping to.

use super::capture::Captured;
use super::data::{Event, EventKind, State};

/// The events of an episode, in order.
pub(super) fn events(episode: &Captured) -> Vec<Event> {
    let mut events = Vec::new();
    for (at, state) in episode.states.iter().enumerate() {
        let before = at.checked_sub(1).and_then(|before| episode.states.get(before));
        for building in 0..episode.buildings.len() {
            if let Some((kind, what)) = change(before, state, building) {
                let text = format!("building {} {what}", episode.buildings[building].name);
                events.push(Event { at, kind, building: Some(building), text });
            }
        }
        let moved = before.map(|before| moved(episode, before, state)).unwrap_or_default();
        if !moved.is_empty() {
            let text = format!("reallocated: {}", moved.join(", "));
            events.push(Event { at, kind: EventKind::Reallocated, building: None, text });
        }
    }
    events
}

/// What a building went through since the state before; the first state has none.
fn change(
    before: Option<&State>,
    state: &State,
    building: usize,
) -> Option<(EventKind, &'static str)> {
    let (status, fire) = (state.status[building], state.fire[building]);
    let Some(before) = before else {
        return (fire > 0.0).then_some((EventKind::Fire, "burns from the start"));
    };
    match (before.status[building], status) {
        (0, 1) => return Some((EventKind::Complete, "is complete")),
        (0, 2) => return Some((EventKind::BurnedDown, "burned down")),
        (0, 0) => {}
        _ => return None,
    }
    let ignited = state.next_fire[building] > before.next_fire[building];
    match (before.fire[building] > 0.0, fire > 0.0) {
        (true, false) => Some((EventKind::Extinguished, "is extinguished")),
        (false, true) => Some((EventKind::Fire, "catches fire")),
        (true, true) if ignited && before.fire[building] < 1.0 => {
            Some((EventKind::Fire, "flares up again"))
        }
        _ => None,
    }
}

/// The agents that got another building, as text. In final states nobody is assigned.
fn moved(episode: &Captured, before: &State, state: &State) -> Vec<String> {
    let pairs = before.allocation.iter().zip(&state.allocation).enumerate();
    let moved = pairs.filter_map(|(agent, (from, to))| to.filter(|_| from != to).map(|to| (agent, to)));
    moved
        .map(|(agent, to)| {
            let building = &episode.buildings[usize::from(to)].name;
            format!("{} to {building}", episode.agents[agent].name)
        })
        .collect()
}
