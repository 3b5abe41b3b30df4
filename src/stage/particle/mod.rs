//! What pages show of the particle world.

mod data;
mod events;

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use sortie_envs::particle::{Disc, ENTRY, Picture, Point, picture_of};
use sortie_envs::{Entry, Episode, Spec};

pub use data::{AgentFacts, Event, EventKind, Facts, State, Step};

use crate::names::lettered;
use crate::show::{Glance, Show, Shown};
use crate::thoughts::rounded;

/// The particle world.
#[derive(Debug)]
pub struct Plane;

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
        before.map(|before| events::events(facts, at, before, now)).unwrap_or_default()
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
