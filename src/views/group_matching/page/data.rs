//! What a page knows: one episode as the page's script reads it.

use serde::Serialize;

use crate::views::mind::Thought;

/// Version of this data; the page's script and these types change together.
pub(super) const FORMAT: u32 = 1;

/// An episode as it went.
#[derive(Debug, Serialize)]
pub(super) struct Captured {
    /// Cells of the ring.
    pub(super) cells: usize,
    pub(super) actions: Vec<String>,
    pub(super) agents: Vec<AgentFacts>,
    pub(super) groups: Vec<GroupFacts>,
    /// One more than steps: the last one is final.
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) events: Vec<Event>,
    pub(super) result: EpisodeResult,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub(super) struct AgentFacts {
    /// Its group's letter and its number.
    pub(super) name: String,
    /// Its groups.
    pub(super) groups: Vec<usize>,
}

/// What does not change about a group.
#[derive(Debug, Serialize)]
pub(super) struct GroupFacts {
    /// A letter.
    pub(super) name: String,
    pub(super) members: Vec<usize>,
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EpisodeResult {
    /// All groups have gathered.
    Solved,
    /// The time ran out.
    TimedOut,
}

/// One state. Lists go by agent or by group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct State {
    /// The cell of every agent.
    pub(super) places: Vec<u8>,
    /// The agents that each agent can see, itself included.
    pub(super) sees: Vec<Vec<usize>>,
    /// The first group of every agent.
    pub(super) allocation: Vec<usize>,
    /// Whether each group shares a cell.
    pub(super) gathered: Vec<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) thoughts: Option<Vec<Thought>>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Step {
    /// What agents meant to do.
    pub(super) actions: Vec<u16>,
    /// The team's reward.
    pub(super) reward: f64,
    /// Agents that chance moved elsewhere.
    pub(super) slipped: Vec<usize>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Event {
    /// The state in which it shows.
    pub(super) at: usize,
    pub(super) kind: EventKind,
    /// The group, or the agent that slipped.
    pub(super) of: usize,
    pub(super) text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EventKind {
    /// A group has gathered, or begins so.
    Gathered,
    /// A group that had gathered has not any more.
    Parted,
    /// Chance moved an agent elsewhere.
    Slipped,
}
