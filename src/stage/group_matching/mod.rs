//! What pages show of Group Matching.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use serde::Serialize;
use sortie_envs::group_matching::{ENTRY, LEFT, RIGHT, Ring, ring_of, sizes};
use sortie_envs::{EntitySet, Entry, Observation, members};

use crate::show::{Glance, Show, Shown};
use crate::thoughts::{lettered, rounded};

/// Group Matching.
#[derive(Debug)]
pub struct Groups;

/// What does not change about a ring.
#[derive(Debug, Serialize)]
pub struct Facts {
    /// Cells of the ring.
    cells: usize,
    actions: Vec<String>,
    agents: Vec<AgentFacts>,
    groups: Vec<GroupFacts>,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
struct AgentFacts {
    /// Its group's letter and its number.
    name: String,
    /// Its groups.
    groups: Vec<usize>,
}

/// What does not change about a group.
#[derive(Debug, Serialize)]
struct GroupFacts {
    /// A letter.
    name: String,
    members: Vec<usize>,
}

/// One state. Lists go by agent or by group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// The cell of every agent.
    places: Vec<u8>,
    /// The agents that each agent can see, itself included.
    sees: Vec<Vec<usize>>,
    /// The first group of every agent.
    allocation: Vec<usize>,
    /// Whether each group shares a cell.
    gathered: Vec<bool>,
}

/// What happened between two states.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    /// What agents meant to do.
    actions: Vec<u16>,
    /// The team's reward.
    reward: f64,
    /// Agents that chance moved elsewhere.
    slipped: Vec<usize>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// The state in which it shows.
    at: usize,
    kind: EventKind,
    /// The group, or the agent that slipped.
    of: usize,
    text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
enum EventKind {
    /// A group has gathered, or begins so.
    Gathered,
    /// A group that had gathered has not any more.
    Parted,
    /// Chance moved an agent elsewhere.
    Slipped,
}

impl Show for Groups {
    type Facts = Facts;
    type State = State;
    type Step = Step;
    type Event = Event;

    fn entry() -> &'static Entry {
        &ENTRY
    }

    fn facts(first: Glance<'_>) -> Facts {
        let (spec, ring) = (first.worlds.spec(), ring(first));
        let groups: Vec<GroupFacts> = ring
            .groups()
            .enumerate()
            .map(|(group, set)| GroupFacts {
                name: lettered(group),
                members: members(set).collect(),
            })
            .collect();
        let agent = |agent: usize| {
            let own = groups.iter().enumerate().filter(|(_, facts)| facts.members.contains(&agent));
            let own: Vec<usize> = own.map(|(group, _)| group).collect();
            let first = own.first().map_or("-", |group| &groups[*group].name);
            AgentFacts { name: format!("{first}{agent}"), groups: own }
        };
        let agents = (0..ring.cells.len()).map(agent).collect();
        Facts { cells: sizes(spec).cells, actions: spec.actions.clone(), agents, groups }
    }

    fn agents(facts: &Facts) -> usize {
        facts.agents.len()
    }

    fn state(seen: Glance<'_>) -> State {
        let (ring, mut observed) = (ring(seen), Observation::default());
        seen.worlds.observe(seen.state, 0, EntitySet::MAX, &mut observed);
        let sees = observed.observable.iter().map(|set| members(set & observed.present).collect());
        let first = |agent: usize| ring.groups().position(|set| set >> agent & 1 == 1).unwrap_or(0);
        State {
            places: ring.cells.to_vec(),
            sees: sees.collect(),
            allocation: (0..ring.cells.len()).map(first).collect(),
            gathered: ring.groups().map(|set| ring.is_matched(set)).collect(),
        }
    }

    fn step(seen: Glance<'_>, actions: &[u16], reward: f64, [before, after]: [&State; 2]) -> Step {
        let cells = sizes(seen.worlds.spec()).cells;
        let meant = |cell: u8, action: u16| {
            let by = match action {
                LEFT => cells - 1,
                RIGHT => 1,
                _ => 0,
            };
            (usize::from(cell) + by) % cells
        };
        let agents = before.places.iter().zip(actions).zip(&after.places).enumerate();
        let slipped =
            agents.filter(|(_, ((from, action), to))| meant(**from, **action) != usize::from(**to));
        let slipped = slipped.map(|(agent, _)| agent).collect();
        Step { actions: actions.to_vec(), reward: rounded(reward), slipped }
    }

    fn events(
        facts: &Facts,
        at: usize,
        before: Option<&Shown<Self>>,
        now: &Shown<Self>,
    ) -> Vec<Event> {
        let slipped = now.step.as_ref().map(|step| &step.slipped[..]).unwrap_or_default();
        let slipped = slipped.iter().map(|agent| {
            let text = format!("{} slips", facts.agents[*agent].name);
            Event { at, kind: EventKind::Slipped, of: *agent, text }
        });
        let mut events: Vec<Event> = slipped.collect();
        for (of, group) in facts.groups.iter().enumerate().filter(|(_, it)| it.members.len() > 1) {
            let was = before.is_some_and(|before| before.state.gathered[of]);
            let (kind, what) = match (was, now.state.gathered[of]) {
                (false, true) if at == 0 => (EventKind::Gathered, "is together from the start"),
                (false, true) => (EventKind::Gathered, "gathers"),
                (true, false) => (EventKind::Parted, "parts"),
                _ => continue,
            };
            events.push(Event { at, kind, of, text: format!("group {} {what}", group.name) });
        }
        events
    }
}

fn ring(seen: Glance<'_>) -> Ring<'_> {
    ring_of(&sizes(seen.worlds.spec()), seen.state).expect("the environment wrote it")
}
