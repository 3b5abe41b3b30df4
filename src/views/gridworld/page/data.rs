//! What a page knows: one episode as the page's script reads it.

use serde::Serialize;

/// Version of this data; the page's script and these types change together.
pub(super) const FORMAT: u32 = 1;

/// An episode as it went.
#[derive(Debug, Default, Serialize)]
pub(super) struct Captured {
    /// "2 agents".
    pub(super) team: String,
    pub(super) agents: Vec<AgentFacts>,
    /// Rows of the map: `#` walls, `!` pits, `A` to `H` treasures, doors from `$` on, all else is free.
    pub(super) map: Vec<String>,
    /// `[agents, cells]`: how often each agent was where while it learned; empty where that is not known.
    pub(super) visits: Vec<Vec<u32>>,
    /// One more than steps: the last one is final.
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) events: Vec<Event>,
    /// `solved` or `timed-out`.
    pub(super) result: &'static str,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub(super) struct AgentFacts {
    /// Its number.
    pub(super) name: String,
    pub(super) actions: Vec<String>,
}

/// One state. Lists go by agent, or by pit in the order of cells.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct State {
    pub(super) cells: Vec<u16>,
    /// Kinds of treasures as bits.
    pub(super) found: Vec<u8>,
    /// Tiers that are finished.
    pub(super) tiers: u8,
    /// Probabilities that pits open next.
    pub(super) pits: Vec<f64>,
    /// Numbers of pits that are open.
    pub(super) open: Vec<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) thoughts: Option<Vec<Thought>>,
}

/// What one agent thinks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Thought {
    /// What each action is worth to the team.
    pub(super) utilities: Vec<f64>,
    /// None where it never was, or where the team does not tell.
    pub(super) heads: Vec<Head>,
}

/// What one of the heads thinks by which an agent explored.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Head {
    pub(super) name: String,
    /// Its intrinsic reward for being here.
    pub(super) pays: f64,
    /// The action that it likes best.
    pub(super) likes: u16,
    /// Whether the agent acts by it.
    pub(super) acts: bool,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Step {
    pub(super) actions: Vec<u16>,
    /// The team's reward.
    pub(super) reward: f64,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Event {
    /// The state in which it shows.
    pub(super) at: usize,
    pub(super) kind: EventKind,
    /// The agent; none of what the team did.
    pub(super) of: Option<usize>,
    pub(super) text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EventKind {
    /// An agent finds a treasure.
    Found,
    /// A tier is finished.
    Tier,
    /// An agent falls into a pit, and is at its start again.
    Fall,
}
