//! SaveTheCity: a team extinguishes and repairs burning buildings (dissertation chapter 7).
//!
//! Agrees bit for bit with the dissertation's public code from the same state, actions and collision
//! losers. Buildings and subtasks are the same thing and share indices.

mod bytes;
mod causes;
mod decode;
mod environment;
mod episode;
#[cfg(feature = "std")]
pub mod golden;
mod grid;
mod observation;
mod rules;
mod scenarios;
mod scripted;
mod simulator;
mod state;

pub use causes::Cause;
pub use decode::CityDecoder;
pub use environment::{ENTRY, with_city};
pub use episode::EpisodeMetrics;
pub use grid::Symmetry;
pub use observation::{
    FEATURE_NAMES, FEATURES, RELATIONS, agent_features, agent_relation, building_features,
    building_relation, potential, write_agent_row, write_building_row, write_relation,
};
pub use rules::{
    ACTION_NAMES, ACTIONS, Bounce, Constants, FREEZE, availability_code, availability_codes,
    can_approach,
};
pub use scenarios::{BuildingPlan, CityError, SET_NAMES, Scenario, ScenarioSet};
pub use scripted::{
    AllocationRule, ScriptedTeam, coordinated_allocation, heuristic_allocation, random_actions,
    random_allocation, scripted_actions,
};
pub use simulator::SaveTheCity;
pub use state::{
    AgentKind, AgentState, BuildingKind, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS,
    NO_BUILDING, SIDE, Status, manhattan,
};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
