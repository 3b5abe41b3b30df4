//! What a page knows: one episode as the page's script reads it.

use serde::Serialize;

use crate::views::mind::Thought;

/// Version of this data; the page's script and these types change together.
pub(super) const FORMAT: u32 = 1;

/// One episode.
#[derive(Debug, Serialize)]
pub(super) struct Page {
    pub(super) format: u32,
    /// What was viewed: a run, a bundle, `scripted` or the name of a recording.
    pub(super) subject: String,
    /// Who assigned agents; `None` where a recording does not say.
    pub(super) allocation: Option<String>,
    /// `ENV/SET`.
    pub(super) env: String,
    /// Seed and number of a played episode.
    pub(super) episode: Option<(u64, usize)>,
    /// What the reader must know about where figures come from.
    pub(super) notes: Vec<String>,
    pub(super) side: u8,
    pub(super) actions: &'static [&'static str],
    pub(super) agents: Vec<AgentFacts>,
    pub(super) buildings: Vec<BuildingFacts>,
    /// One more than steps: the last one is final.
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) events: Vec<Event>,
    pub(super) result: EpisodeResult,
}

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub(super) struct AgentFacts {
    /// Its kind's letter and its number.
    pub(super) name: String,
    pub(super) kind: &'static str,
}

/// What does not change about a building.
#[derive(Debug, Serialize)]
pub(super) struct BuildingFacts {
    /// A letter.
    pub(super) name: String,
    pub(super) kind: &'static str,
    pub(super) x: u8,
    pub(super) y: u8,
    /// Steps from one ignition to the next.
    pub(super) period: u16,
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EpisodeResult {
    /// All buildings are complete.
    Solved,
    /// Some building burned down.
    Lost,
    /// The time ran out.
    TimedOut,
}

/// One state, and what the team thinks in it. Lists go by agent or by building.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct State {
    /// Columns and rows of the agents.
    pub(super) places: Vec<(u8, u8)>,
    pub(super) health: Vec<f64>,
    pub(super) fire: Vec<f64>,
    /// 0 open, 1 complete, 2 burned down.
    pub(super) status: Vec<u8>,
    pub(super) next_fire: Vec<u16>,
    /// Bit u set where action u is available.
    pub(super) available: Vec<u16>,
    /// Each agent's building.
    pub(super) allocation: Vec<Option<u8>>,
    /// Whether the allocator decided in this state.
    pub(super) decided: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) thoughts: Option<Vec<Thought>>,
    /// What teams are worth, one entry per building, none for closed ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) values: Option<Vec<Option<TeamValues>>>,
}

/// What the allocator expects of teams at one building.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct TeamValues {
    /// Of the team that is there.
    pub(super) chosen: f64,
    /// Of nobody.
    pub(super) nobody: f64,
    /// The most valuable other teams, best first: their agents and their value.
    pub(super) others: Vec<(Vec<usize>, f64)>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Step {
    pub(super) actions: Vec<u16>,
    /// The team's reward.
    pub(super) reward: f64,
    /// One per building.
    pub(super) task_rewards: Vec<f64>,
    /// Agents that ran into another and went back.
    pub(super) bounced: Vec<u8>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Event {
    /// The state in which it shows.
    pub(super) at: usize,
    pub(super) kind: EventKind,
    /// The building; none for reallocations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) building: Option<usize>,
    pub(super) text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum EventKind {
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
