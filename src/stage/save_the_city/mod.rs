//! SaveTheCity as pages show it.

mod data;
mod events;
mod facts;
mod show;
mod values;

pub use data::{
    AgentFacts, BuildingFacts, EpisodeResult, Event, EventKind, State, Step, TeamValues,
};
pub use events::Names;
pub use facts::{agent_facts, building_facts, result, state, step};
pub use show::City;
pub use values::candidates;
