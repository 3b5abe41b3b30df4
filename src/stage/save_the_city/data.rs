//! What pages know of a city, as their script reads it, and what is worth jumping to.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use serde::Serialize;

use crate::thoughts::Thought;

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub struct AgentFacts {
    /// Its kind's letter and its number.
    pub name: String,
    /// `firefighter`, `builder` or `generalist`.
    pub kind: &'static str,
}

/// What does not change about a building.
#[derive(Debug, Serialize)]
pub struct BuildingFacts {
    /// A letter.
    pub name: String,
    /// `fast` or `slow`: how it burns.
    pub kind: &'static str,
    /// Its column.
    pub x: u8,
    /// Its row.
    pub y: u8,
    /// Steps from one ignition to the next.
    pub period: u16,
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EpisodeResult {
    /// All buildings are complete.
    Solved,
    /// Some building burned down.
    Lost,
    /// The time ran out.
    TimedOut,
}

/// One state, and what the team thinks in it. Lists go by agent or by building.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// Columns and rows of the agents.
    pub places: Vec<(u8, u8)>,
    /// Of the buildings, 1 = complete.
    pub health: Vec<f64>,
    /// Of the buildings, 1 = full.
    pub fire: Vec<f64>,
    /// 0 open, 1 complete, 2 burned down.
    pub status: Vec<u8>,
    /// Steps until each building burns again.
    pub next_fire: Vec<u16>,
    /// Bit u set where action u is available.
    pub available: Vec<u16>,
    /// Each agent's building.
    pub allocation: Vec<Option<u8>>,
    /// Whether the allocator decided in this state.
    pub decided: bool,
    /// What each agent thinks, where anything is known of it; none of agents that do not decide.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thoughts: Option<Vec<Option<Thought>>>,
    /// What teams are worth, one entry per building, none for closed ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub values: Option<Vec<Option<TeamValues>>>,
}

/// What the allocator expects of teams at one building.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TeamValues {
    /// Of the team that is there.
    pub chosen: f64,
    /// Of nobody.
    pub nobody: f64,
    /// The most valuable other teams, best first: their agents and their value.
    pub others: Vec<(Vec<usize>, f64)>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Of the agents.
    pub actions: Vec<u16>,
    /// The team's reward.
    pub reward: f64,
    /// One per building.
    pub task_rewards: Vec<f64>,
    /// Agents that ran into another and went back.
    pub bounced: Vec<u8>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Event {
    /// The state in which it shows.
    pub at: usize,
    /// What it is.
    pub kind: EventKind,
    /// The building; none for reallocations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub building: Option<usize>,
    /// What is told of it.
    pub text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A building catches fire, or burns when the episode begins.
    Fire,
    /// A fire is out.
    Extinguished,
    /// A building is repaired.
    Complete,
    /// A building burned down.
    BurnedDown,
    /// Agents get another building.
    Reallocated,
}

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
    use alloc::borrow::ToOwned;
    use alloc::vec;

    use super::*;

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
