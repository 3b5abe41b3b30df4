//! The game of crafting.

use sortie_envs::Entry;
use sortie_envs::crafting::{Crafting, ENTRY};

use crate::milestones::KnownGame;

impl KnownGame for Crafting {
    const ENTRY: &'static Entry = &ENTRY;
}
