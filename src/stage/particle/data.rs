//! What pages know of the plane, as their script reads it.

use alloc::string::String;
use alloc::vec::Vec;

use serde::Serialize;
use sortie_envs::particle::Point;

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
