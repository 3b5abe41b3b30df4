//! The gridworld of coordinated exploration: agents look for treasures at the ends of a maze with pits
//! (dissertation chapter 4).
//!
//! Agrees exactly with the dissertation's public code from the same state and draws. Each agent sees one vector of its
//! own: walls and pits next to it, what it found itself, where it is and who is near. The team shares one reward.

mod bytes;
mod environment;
mod map;
mod observation;
mod rules;

pub use bytes::state_bytes;
pub use environment::{ENTRY, Gridworld, SET_NAMES};
pub use map::{CELLS, Draw, MAX_AGENTS, MAX_TREASURES, Map, MapError, SIDE, draw_map};
pub use rules::{Chance, Found, Normals, Pit, Rules, Task};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";

/// Names of the actions.
pub const ACTION_NAMES: [&str; 5] = ["up", "down", "left", "right", "stay"];
/// The action of an agent that stays where it is.
pub const STAY: u8 = 4;
