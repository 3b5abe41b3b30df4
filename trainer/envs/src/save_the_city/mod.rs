//! SaveTheCity: a team extinguishes and repairs burning buildings (dissertation chapter 7).
//!
//! Agrees bit for bit with the dissertation's public code from the same state, actions and collision
//! losers. Buildings and subtasks are the same thing and share indices.

mod allocation;
mod bytes;
mod causes;
mod checks;
mod coordinated;
mod decode;
mod episode;
mod error;
mod features;
#[cfg(feature = "std")]
pub mod golden;
mod grid;
mod heuristic;
mod interference;
mod metrics;
mod potential;
mod relation;
mod reset;
mod rules;
mod scenarios;
mod scripted;
mod seam;
mod simulator;
mod spec;
mod state;
mod symmetry;

pub use allocation::{AllocationRule, random_allocation};
pub use causes::Cause;
pub use coordinated::coordinated_allocation;
pub use decode::CityDecoder;
pub use error::CityError;
pub use features::{
    FEATURE_NAMES, FEATURES, agent_features, building_features, write_agent_row, write_building_row,
};
pub use heuristic::heuristic_allocation;
pub use metrics::EpisodeMetrics;
pub use potential::potential;
pub use relation::{RELATIONS, agent_relation, building_relation, write_relation};
pub use rules::{
    ACTION_NAMES, ACTIONS, Bounce, Constants, FREEZE, availability_code, availability_codes,
    can_approach,
};
pub use scenarios::{BuildingPlan, SET_NAMES, Scenario, ScenarioSet};
pub use scripted::{ScriptedTeam, random_actions, scripted_actions};
pub use seam::{ENTRY, with_city};
pub use simulator::SaveTheCity;
pub use state::{
    AgentKind, AgentState, BuildingKind, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS,
    NO_BUILDING, SIDE, Status, manhattan,
};
pub use symmetry::Symmetry;

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
