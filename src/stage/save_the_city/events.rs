//! What is worth jumping to.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::data::{AgentFacts, BuildingFacts, Event, EventKind, State};

/// Who is there, for what is told of it.
#[derive(Clone, Copy, Debug)]
pub struct Names<'a> {
    /// The agents.
    pub agents: &'a [AgentFacts],
    /// The buildings.
    pub buildings: &'a [BuildingFacts],
}

impl Names<'_> {
    /// The events of an episode, in order.
    pub fn events(&self, states: &[State]) -> Vec<Event> {
        let before = |at: usize| at.checked_sub(1).and_then(|before| states.get(before));
        let events = states.iter().enumerate();
        events.flat_map(|(at, state)| self.events_at(at, before(at), state)).collect()
    }

    /// The events that show in a state; the first one has none before it.
    pub fn events_at(&self, at: usize, before: Option<&State>, state: &State) -> Vec<Event> {
        let mut events = Vec::new();
        for (building, BuildingFacts { name, .. }) in self.buildings.iter().enumerate() {
            if let Some((kind, what)) = change(before, state, building) {
                let text = format!("building {name} {what}");
                events.push(Event { at, kind, building: Some(building), text });
            }
        }
        let moved = before.map(|before| self.moved(before, state)).unwrap_or_default();
        if !moved.is_empty() {
            let text = format!("reallocated: {}", moved.join(", "));
            events.push(Event { at, kind: EventKind::Reallocated, building: None, text });
        }
        events
    }

    /// The agents that got another building, as text. In final states nobody is assigned.
    fn moved(&self, before: &State, state: &State) -> Vec<String> {
        let pairs = before.allocation.iter().zip(&state.allocation).enumerate();
        let moved =
            pairs.filter_map(|(agent, (from, to))| to.filter(|_| from != to).map(|to| (agent, to)));
        moved
            .map(|(agent, to)| {
                let building = &self.buildings[usize::from(to)].name;
                format!("{} to {building}", self.agents[agent].name)
            })
            .collect()
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::borrow::ToOwned;
    use alloc::vec;

    /// One agent at one of two buildings; building a has this status and fire, and burns next then.
    fn state(status: u8, fire: f64, next_fire: u16, task: Option<u8>) -> State {
        State {
            places: vec![(0, 0)],
            health: vec![0.5, 0.5],
            fire: vec![fire, 0.0],
            status: vec![status, 0],
            next_fire: vec![next_fire, 20],
            available: vec![1],
            allocation: vec![task],
            decided: false,
            thoughts: None,
            values: None,
        }
    }

    fn told(states: Vec<State>) -> Vec<(usize, EventKind, String)> {
        let building =
            |name: &str| BuildingFacts { name: name.into(), kind: "slow", x: 1, y: 1, period: 20 };
        let agents = [AgentFacts { name: "B0".into(), kind: "builder" }];
        let names = Names { agents: &agents, buildings: &[building("a"), building("b")] };
        names.events(&states).into_iter().map(|event| (event.at, event.kind, event.text)).collect()
    }

    #[test]
    fn every_turn_of_an_episode_is_an_event() {
        let told = told(vec![
            state(0, 1.0, 3, Some(0)),
            state(0, 0.5, 2, Some(0)),
            state(0, 1.0, 20, Some(1)),
            state(0, 0.0, 19, Some(1)),
            state(0, 1.0, 20, Some(0)),
            state(1, 0.0, 1000, None),
        ]);
        let event = |at, kind, text: &str| (at, kind, text.to_owned());
        let expected = [
            event(0, EventKind::Fire, "building a burns from the start"),
            event(2, EventKind::Fire, "building a flares up again"),
            event(2, EventKind::Reallocated, "reallocated: B0 to b"),
            event(3, EventKind::Extinguished, "building a is extinguished"),
            event(4, EventKind::Fire, "building a catches fire"),
            event(4, EventKind::Reallocated, "reallocated: B0 to a"),
            event(5, EventKind::Complete, "building a is complete"),
        ];
        assert_eq!(told, expected);
    }

    #[test]
    fn a_fire_that_grows_back_to_full_is_no_new_one() {
        let told =
            told(vec![state(0, 0.95, 9, None), state(0, 1.0, 8, None), state(2, 0.0, 9, None)]);
        let kinds: Vec<EventKind> = told.into_iter().map(|(_, kind, _)| kind).collect();
        assert_eq!(kinds, [EventKind::Fire, EventKind::BurnedDown]);
    }
}
