//! The rooms of the treasure.

use sortie_envs::Entry;
use sortie_envs::treasure_rooms::{ENTRY, TreasureRooms};

use crate::milestones::KnownGame;

impl KnownGame for TreasureRooms {
    const ENTRY: &'static Entry = &ENTRY;
}
