//! What pages show of games on a grid with milestones.

use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::any::Any;
use core::marker::PhantomData;

use serde::Serialize;
use sortie_envs::Entry;
use sortie_envs::milestones::{Game, Milestones, World};

use crate::show::{Glance, Show, Shown};
use crate::thoughts::rounded;

/// A game of milestones.
#[derive(Debug)]
pub struct Board<G>(PhantomData<G>);

/// What does not change about a game.
#[derive(Debug, Serialize)]
pub struct Facts {
    team: &'static str,
    agents: Vec<AgentFacts>,
    /// Cells of a row, and rows.
    size: u8,
    /// Kinds of objects by their numbers.
    objects: &'static [&'static str],
    items: Vec<String>,
    milestones: Vec<String>,
}

/// What does not change about the agent.
#[derive(Debug, Serialize)]
struct AgentFacts {
    name: &'static str,
    actions: Vec<String>,
}

/// One state.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    /// The object of every cell, row by row.
    cells: Vec<u8>,
    /// Kinds of objects, as bits, that are open or pressed.
    open: u16,
    /// The agent's cell, and where it looks: right, down, left, up.
    at: u8,
    direction: u8,
    /// How many it carries of each item.
    carried: Vec<u16>,
    /// The milestones that can be reached next, as bits.
    truth: u32,
}

/// What happened between two states.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    actions: Vec<u16>,
    reward: f64,
    /// The milestone that was reached.
    reached: Option<usize>,
}

/// A milestone that was reached.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// The state in which it shows.
    at: usize,
    text: String,
}

/// A game, with how it is found.
pub trait KnownGame: Game {
    /// How it is found.
    const ENTRY: &'static Entry;
}

impl<G: KnownGame> Show for Board<G> {
    type Facts = Facts;
    type State = State;
    type Step = Step;
    type Event = Event;

    fn entry() -> &'static Entry {
        G::ENTRY
    }

    fn facts(first: Glance<'_>) -> Facts {
        let spec = first.worlds.spec();
        let items = spec.features.iter().filter_map(|name| name.strip_prefix("items."));
        Facts {
            team: "1 agent",
            agents: vec![AgentFacts { name: "agent", actions: spec.actions.clone() }],
            size: world::<G>(first).size,
            objects: G::OBJECTS,
            items: items.map(String::from).collect(),
            milestones: spec.milestones.clone(),
        }
    }

    fn agents(facts: &Facts) -> usize {
        facts.agents.len()
    }

    fn state(seen: Glance<'_>) -> State {
        let world = world::<G>(seen);
        let cells = usize::from(world.size) * usize::from(world.size);
        State {
            cells: world.cells[..cells].to_vec(),
            open: world.open,
            at: world.position,
            direction: world.direction,
            carried: world.inventory.to_vec(),
            truth: seen.worlds.affordances(seen.state).unwrap_or(0),
        }
    }

    fn step(seen: Glance<'_>, actions: &[u16], reward: f64, _: [&State; 2]) -> Step {
        let reached = seen.worlds.milestone(seen.instance);
        Step { actions: actions.to_vec(), reward: rounded(reward), reached }
    }

    fn events(facts: &Facts, at: usize, _: Option<&Shown<Self>>, now: &Shown<Self>) -> Vec<Event> {
        let reached = now.step.as_ref().and_then(|step| step.reached);
        let name = reached.and_then(|milestone| facts.milestones.get(milestone));
        name.map(|name| Event { at, text: name.clone() }).into_iter().collect()
    }
}

/// The grid.
fn world<G: Game>(seen: Glance<'_>) -> &World {
    let worlds: &dyn Any = seen.worlds;
    let worlds: &Milestones<G> = worlds.downcast_ref().expect("made by this environment's entry");
    worlds.world(seen.instance)
}
