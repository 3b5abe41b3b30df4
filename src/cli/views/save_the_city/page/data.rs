//! What a page knows: one episode as the page's script reads it.

use serde::Serialize;
use sortie_stage::save_the_city::{AgentFacts, BuildingFacts, EpisodeResult, Event, State, Step};

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
