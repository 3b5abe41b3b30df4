//! What pages show of the particle world.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Serialize;
use sortie_envs::particle::{Disc, ENTRY, Picture, Point, picture_of};
use sortie_envs::{Entry, Episode, Spec};

use crate::show::{Glance, Show, Shown};
use crate::thoughts::{lettered, rounded};

/// The particle world.
#[derive(Debug)]
pub struct Plane;

/// What does not change while an episode is played.
#[derive(Debug, Serialize)]
pub struct Facts {
    /// How many agents there are of each role.
    pub team: String,
    /// The agents.
    pub agents: Vec<AgentFacts>,
    /// Letters of landmarks; those of treasures are their kinds'.
    pub things: Vec<Option<String>>,
    /// Kinds of treasures.
    pub kinds: Vec<String>,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub struct AgentFacts {
    /// Its number.
    pub name: String,
    /// What it is.
    pub role: &'static str,
    /// What it can do.
    pub actions: Vec<String>,
    /// None of an agent that stands nowhere.
    pub radius: Option<f64>,
    /// The kind of treasure that it takes.
    pub takes: Option<u8>,
    /// The agent that it leads, or that leads it.
    pub partner: Option<usize>,
    /// The landmark where it, or the agent that it leads, should be.
    pub goal: Option<usize>,
}

/// One state. Lists go by agent or by thing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// Of the agents; none of those that stand nowhere.
    pub places: Vec<Option<Point>>,
    /// Kinds of treasures.
    pub holds: Vec<Option<u8>>,
    /// Messages.
    pub says: Vec<Option<u8>>,
    /// None where a treasure was just taken.
    pub things: Vec<Option<Point>>,
    /// Of the treasures.
    pub kinds: Vec<Option<u8>>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Of the agents.
    pub actions: Vec<u16>,
    /// The team's reward, the mean of the agents'.
    pub reward: f64,
    /// Of the agents.
    pub rewards: Vec<f64>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Event {
    /// The state in which it shows.
    pub at: usize,
    /// What it is.
    pub kind: EventKind,
    /// The agent.
    pub of: usize,
    /// What is told of it.
    pub text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A collector takes a treasure.
    Taken,
    /// A bank gets one.
    Delivered,
    /// A rover comes near its goal.
    Near,
    /// Two agents touch that lose by it.
    Touch,
}

/// Agents of these roles lose by touching each other.
const BUMPING: [&str; 2] = ["collector", "agent"];

impl Show for Plane {
    type Facts = Facts;
    type State = State;
    type Step = Step;
    type Event = Event;

    fn entry() -> &'static Entry {
        &ENTRY
    }

    fn facts(first: Glance<'_>) -> Facts {
        let (spec, picture) = (first.worlds.spec(), picture(first));
        let agents = picture.agents.iter().enumerate().map(|(agent, drawn)| AgentFacts {
            name: agent.to_string(),
            role: role_of(spec, agent),
            actions: spec.actions_of(agent).to_vec(),
            radius: drawn.disc.map(|disc| disc.radius),
            takes: drawn.takes,
            partner: drawn.partner,
            goal: drawn.goal,
        });
        let things = picture.things.iter().enumerate();
        let things = things.map(|(number, thing)| thing.kind.is_none().then(|| lettered(number)));
        let takers = picture.agents.iter().filter_map(|agent| agent.takes);
        Facts {
            team: team(spec),
            things: things.collect(),
            kinds: takers.map(kind_name).collect(),
            agents: agents.collect(),
        }
    }

    fn agents(facts: &Facts) -> usize {
        facts.agents.len()
    }

    fn state(seen: Glance<'_>) -> State {
        let place = |disc: Option<Disc>| disc.map(|disc| disc.place.map(rounded));
        let places = |discs: &mut dyn Iterator<Item = Option<Disc>>| -> Vec<Option<Point>> {
            discs.map(place).collect()
        };
        let Picture { agents, things } = picture(seen);
        State {
            places: places(&mut agents.iter().map(|agent| agent.disc)),
            holds: agents.iter().map(|agent| agent.holds).collect(),
            says: agents.iter().map(|agent| agent.says).collect(),
            things: places(&mut things.iter().map(|thing| thing.disc)),
            kinds: things.iter().map(|thing| thing.kind).collect(),
        }
    }

    fn step(seen: Glance<'_>, actions: &[u16], reward: f64, _: [&State; 2]) -> Step {
        let rewards = seen.worlds.agent_rewards(seen.instance);
        Step {
            actions: actions.to_vec(),
            reward: rounded(reward),
            rewards: rewards.iter().copied().map(rounded).collect(),
        }
    }

    fn events(
        facts: &Facts,
        at: usize,
        before: Option<&Shown<Self>>,
        now: &Shown<Self>,
    ) -> Vec<Event> {
        let Some(before) = before else { return Vec::new() };
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

    /// No episode is solved.
    fn result(_: &Episode) -> &'static str {
        "over"
    }
}

fn picture(seen: Glance<'_>) -> Picture {
    picture_of(seen.worlds.spec(), seen.state).expect("the environment wrote it")
}

/// The letter of a kind of treasure; that of its bank is a capital.
pub fn kind_name(kind: u8) -> String {
    lettered(kind.into()).to_lowercase()
}

/// What an agent is.
pub fn role_of(spec: &Spec, agent: usize) -> &'static str {
    spec.role_of(agent).map_or("agent", |role| role.name)
}

/// "6 collectors, 2 banks".
fn team(spec: &Spec) -> String {
    let named = |count: usize, role| format!("{count} {role}{}", if count == 1 { "" } else { "s" });
    match &spec.roles[..] {
        [] => named(spec.shape.agents, "agent"),
        roles => {
            let roles = roles.iter().map(|role| named(role.agents.len(), role.name));
            roles.collect::<Vec<_>>().join(", ")
        }
    }
}

fn distance(one: Option<Point>, other: Option<Point>) -> f64 {
    let (Some(one), Some(other)) = (one, other) else { return f64::INFINITY };
    libm::hypot(one[0] - other[0], one[1] - other[1])
}
