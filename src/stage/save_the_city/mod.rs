//! SaveTheCity as pages show it.

mod cities;
mod data;
mod events;
mod facts;
mod player;
mod values;

pub use data::{
    AgentFacts, BuildingFacts, EpisodeResult, Event, EventKind, State, Step, TeamValues,
};
pub use events::Names;
pub use facts::{agent_facts, building_facts, result, state, step};
pub use player::{News, Opening, Player, golden_hash, memory};
pub use values::candidates;
