//! What pages know of a city, as their script reads it.

use alloc::string::String;
use alloc::vec::Vec;

use serde::Serialize;

use crate::thoughts::Thought;

/// What does not change about an agent.
#[derive(Debug, Serialize)]
pub struct AgentFacts {
    /// Its kind's letter and its number.
    pub name: String,
    /// `firefighter`, `builder` or `generalist`.
    pub kind: &'static str,
}

/// What does not change about a building.
#[derive(Debug, Serialize)]
pub struct BuildingFacts {
    /// A letter.
    pub name: String,
    /// `fast` or `slow`: how it burns.
    pub kind: &'static str,
    /// Its column.
    pub x: u8,
    /// Its row.
    pub y: u8,
    /// Steps from one ignition to the next.
    pub period: u16,
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EpisodeResult {
    /// All buildings are complete.
    Solved,
    /// Some building burned down.
    Lost,
    /// The time ran out.
    TimedOut,
}

/// One state, and what the team thinks in it. Lists go by agent or by building.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// Columns and rows of the agents.
    pub places: Vec<(u8, u8)>,
    /// Of the buildings, 1 = complete.
    pub health: Vec<f64>,
    /// Of the buildings, 1 = full.
    pub fire: Vec<f64>,
    /// 0 open, 1 complete, 2 burned down.
    pub status: Vec<u8>,
    /// Steps until each building burns again.
    pub next_fire: Vec<u16>,
    /// Bit u set where action u is available.
    pub available: Vec<u16>,
    /// Each agent's building.
    pub allocation: Vec<Option<u8>>,
    /// Whether the allocator decided in this state.
    pub decided: bool,
    /// What each agent thinks, where anything is known of it; none of agents that do not decide.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thoughts: Option<Vec<Option<Thought>>>,
    /// What teams are worth, one entry per building, none for closed ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub values: Option<Vec<Option<TeamValues>>>,
}

/// What the allocator expects of teams at one building.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TeamValues {
    /// Of the team that is there.
    pub chosen: f64,
    /// Of nobody.
    pub nobody: f64,
    /// The most valuable other teams, best first: their agents and their value.
    pub others: Vec<(Vec<usize>, f64)>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Of the agents.
    pub actions: Vec<u16>,
    /// The team's reward.
    pub reward: f64,
    /// One per building.
    pub task_rewards: Vec<f64>,
    /// Agents that ran into another and went back.
    pub bounced: Vec<u8>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Event {
    /// The state in which it shows.
    pub at: usize,
    /// What it is.
    pub kind: EventKind,
    /// The building; none for reallocations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub building: Option<usize>,
    /// What is told of it.
    pub text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
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
