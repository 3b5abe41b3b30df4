//! What a page knows: one episode as the page's script reads it.

use serde::Serialize;
use sortie_envs::particle::Point;

use crate::views::mind::Thought;

/// Version of this data; the page's script and these types change together.
pub(super) const FORMAT: u32 = 1;

/// An episode as it went.
#[derive(Debug, Default, Serialize)]
pub(super) struct Captured {
    /// How many agents there are of each role.
    pub(super) team: String,
    pub(super) agents: Vec<AgentFacts>,
    /// Letters of landmarks; those of treasures are their kinds'.
    pub(super) things: Vec<Option<String>>,
    /// Half of the side that is drawn.
    pub(super) half: f64,
    /// Kinds of treasures.
    pub(super) kinds: Vec<String>,
    /// One more than steps: the last one is final.
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) events: Vec<Event>,
    /// `over`: no episode is solved.
    pub(super) result: &'static str,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub(super) struct AgentFacts {
    /// Its number.
    pub(super) name: String,
    pub(super) role: &'static str,
    pub(super) actions: Vec<String>,
    /// None of an agent that stands nowhere.
    pub(super) radius: Option<f64>,
    /// The kind of treasure that it takes.
    pub(super) takes: Option<u8>,
    /// The agent that it leads, or that leads it.
    pub(super) partner: Option<usize>,
    /// The landmark where it, or the agent that it leads, should be.
    pub(super) goal: Option<usize>,
}

/// One state. Lists go by agent or by thing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct State {
    pub(super) places: Vec<Option<Point>>,
    /// Kinds of treasures.
    pub(super) holds: Vec<Option<u8>>,
    /// Messages.
    pub(super) says: Vec<Option<u8>>,
    /// None where a treasure was just taken.
    pub(super) things: Vec<Option<Point>>,
    /// Of the treasures.
    pub(super) kinds: Vec<Option<u8>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) thoughts: Option<Vec<Thought>>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Step {
    pub(super) actions: Vec<u16>,
    /// The team's reward, the mean of the agents'.
    pub(super) reward: f64,
    pub(super) rewards: Vec<f64>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Event {
    /// The state in which it shows.
    pub(super) at: usize,
    pub(super) kind: EventKind,
    /// The agent.
    pub(super) of: usize,
    pub(super) text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EventKind {
    /// A collector takes a treasure.
    Taken,
    /// A bank gets one.
    Delivered,
    /// A rover comes near its goal.
    Near,
    /// Two agents touch that lose by it.
    Touch,
}
