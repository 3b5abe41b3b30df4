//! What a page knows: one episode as the page's script reads it.

use serde::Serialize;

/// Version of this data; the page's script and these types change together.
pub(super) const FORMAT: u32 = 1;

/// An episode as it went.
#[derive(Debug, Default, Serialize)]
pub(super) struct Captured {
    pub(super) team: &'static str,
    pub(super) agents: Vec<AgentFacts>,
    /// Cells of a row, and rows.
    pub(super) size: u8,
    /// Kinds of objects by their numbers.
    pub(super) objects: &'static [&'static str],
    pub(super) items: Vec<String>,
    pub(super) milestones: Vec<String>,
    /// Likelihood from which on a milestone counts as afforded.
    pub(super) threshold: f32,
    /// One more than steps: the last one is final.
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) events: Vec<Event>,
    /// `solved` or `failed`.
    pub(super) result: &'static str,
}

/// What does not change about the agent.
#[derive(Debug, Serialize)]
pub(super) struct AgentFacts {
    pub(super) name: &'static str,
    pub(super) actions: Vec<String>,
}

/// One state.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct State {
    /// The object of every cell, row by row.
    pub(super) cells: Vec<u8>,
    /// Kinds of objects, as bits, that are open or pressed.
    pub(super) open: u16,
    /// The agent's cell, and where it looks: right, down, left, up.
    pub(super) at: u8,
    pub(super) direction: u8,
    /// How many it carries of each item.
    pub(super) carried: Vec<u16>,
    /// The milestones that can be reached next, as bits.
    pub(super) truth: u32,
    /// What the agent thinks; none in the last state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) thought: Option<Thought>,
}

/// What an agent that runs options thinks.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Thought {
    /// The milestone that it goes for, and its step of the option, from 1.
    pub(super) goal: usize,
    pub(super) step: usize,
    /// How likely it believes each milestone can be reached next.
    pub(super) likelihoods: Vec<f64>,
    /// Those that it can choose from, as bits.
    pub(super) mask: u32,
}

/// What happened between two states.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Step {
    pub(super) actions: Vec<u16>,
    pub(super) reward: f64,
    /// The milestone that was reached.
    pub(super) reached: Option<usize>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Event {
    /// The state in which it shows.
    pub(super) at: usize,
    pub(super) text: String,
}
