//! What pages show of the gridworld.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Serialize;
use sortie_envs::gridworld::{ENTRY, SIDE, picture_of};
use sortie_envs::{Entry, members};

use crate::show::{Glance, Show, Shown};
use crate::thoughts::{lettered, rounded};

/// The gridworld.
#[derive(Debug)]
pub struct Maze;

/// What does not change about a maze.
#[derive(Debug, Serialize)]
pub struct Facts {
    /// "2 agents".
    team: String,
    agents: Vec<AgentFacts>,
    /// Rows of the map: `#` walls, `!` pits, `A` to `H` treasures, doors from `$` on, all else is free.
    map: Vec<String>,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
struct AgentFacts {
    /// Its number.
    name: String,
    actions: Vec<String>,
}

/// One state. Lists go by agent, or by pit in the order of cells.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    cells: Vec<u16>,
    /// Kinds of treasures as bits.
    found: Vec<u8>,
    /// Tiers that are finished.
    tiers: u8,
    /// Probabilities that pits open next.
    pits: Vec<f64>,
    /// Numbers of pits that are open.
    open: Vec<usize>,
}

/// What happened between two states.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    actions: Vec<u16>,
    /// The team's reward.
    reward: f64,
    /// Agents that fell into a pit.
    fell: Vec<usize>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// The state in which it shows.
    at: usize,
    kind: EventKind,
    /// The agent; none of what the team did.
    of: Option<usize>,
    text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
enum EventKind {
    /// An agent finds a treasure.
    Found,
    /// A tier is finished.
    Tier,
    /// An agent falls into a pit, and is at its start again.
    Fall,
}

impl Show for Maze {
    type Facts = Facts;
    type State = State;
    type Step = Step;
    type Event = Event;

    fn entry() -> &'static Entry {
        &ENTRY
    }

    fn facts(first: Glance<'_>) -> Facts {
        let spec = first.worlds.spec();
        let agents = spec.shape.agents;
        let fact =
            |agent: usize| AgentFacts { name: agent.to_string(), actions: spec.actions.clone() };
        Facts {
            team: format!("{agents} agents"),
            agents: (0..agents).map(fact).collect(),
            map: spec.map.clone(),
        }
    }

    fn agents(facts: &Facts) -> usize {
        facts.agents.len()
    }

    fn state(seen: Glance<'_>) -> State {
        let picture = picture_of(seen.worlds.spec(), seen.state).expect("the environment wrote it");
        let open = picture.pits.iter().enumerate().filter(|(_, pit)| pit.is_open);
        State {
            open: open.map(|(pit, _)| pit).collect(),
            pits: picture.pits.iter().map(|pit| rounded(pit.probability)).collect(),
            cells: picture.cells,
            found: picture.found,
            tiers: picture.tiers,
        }
    }

    fn step(_: Glance<'_>, actions: &[u16], reward: f64, [before, after]: [&State; 2]) -> Step {
        // Whoever walks comes one cell far.
        let cells = before.cells.iter().zip(&after.cells).enumerate();
        let fell = cells.filter(|(_, (from, to))| distance(**from, **to) > 1);
        let fell = fell.map(|(agent, _)| agent).collect();
        Step { actions: actions.to_vec(), reward: rounded(reward), fell }
    }

    fn events(_: &Facts, at: usize, before: Option<&Shown<Self>>, now: &Shown<Self>) -> Vec<Event> {
        let (Some(before), Some(step)) = (before, &now.step) else { return Vec::new() };
        events(at, step, [&before.state, &now.state])
    }
}

/// What is worth jumping to in a state behind another.
fn events(at: usize, step: &Step, [before, after]: [&State; 2]) -> Vec<Event> {
    let mut events = Vec::new();
    let mut add = |kind, of, text| events.push(Event { at, kind, of, text });
    for agent in 0..after.cells.len() {
        for treasure in members((after.found[agent] & !before.found[agent]).into()) {
            let text = format!("{agent} finds {}", lettered(treasure));
            add(EventKind::Found, Some(agent), text);
        }
        if step.fell.contains(&agent) {
            add(EventKind::Fall, Some(agent), format!("{agent} falls into a pit"));
        }
    }
    if after.tiers > before.tiers {
        add(EventKind::Tier, None, format!("tier {} is finished", after.tiers));
    }
    events
}

/// Steps from one cell to another, if nothing were in the way.
fn distance(one: u16, other: u16) -> usize {
    let place = |cell: u16| [usize::from(cell) / SIDE, usize::from(cell) % SIDE];
    let [one, other] = [place(one), place(other)];
    one[0].abs_diff(other[0]) + one[1].abs_diff(other[1])
}

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeMap;

    use sortie_envs::{Choice, Split};

    use super::*;

    #[test]
    fn finds_falls_and_tiers_are_events() {
        let choice =
            Choice { set: None, split: Split::Test, instances: 1, settings: &BTreeMap::new() };
        let worlds = (ENTRY.open)(&choice).expect("the usual maze");
        let state = |cells: [u16; 2], found: [u8; 2], tiers| State {
            cells: cells.to_vec(),
            found: found.to_vec(),
            tiers,
            pits: Vec::new(),
            open: Vec::new(),
        };
        let states = [
            state([21, 45], [0, 0], 0),
            state([22, 45], [0, 0b100], 0),
            state([42, 100], [1, 0b100], 1),
        ];
        let seen = Glance { worlds: &*worlds, instance: 0, state: &[] };
        let told = |at: usize| -> Vec<String> {
            let pair = [&states[at - 1], &states[at]];
            let step = Maze::step(seen, &[0, 0], 0.0, pair);
            events(at, &step, pair).into_iter().map(|event| event.text).collect()
        };
        assert_eq!(told(1), ["1 finds C"]);
        assert_eq!(told(2), ["0 finds A", "1 falls into a pit", "tier 1 is finished"]);
    }
}
