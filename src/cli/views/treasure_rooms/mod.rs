//! The treasure's rooms as they are shown.

use sortie_envs::treasure_rooms::{ENTRY, TreasureRooms};

use super::View;
use super::milestones::Shown;

pub(super) const VIEW: (&str, &dyn View) = (ENTRY.name, &Shown::<TreasureRooms>::NEW);
