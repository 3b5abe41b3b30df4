//! Crafting as it is shown.

use sortie_envs::crafting::{Crafting, ENTRY};

use super::View;
use super::milestones::Shown;

pub(super) const VIEW: (&str, &dyn View) = (ENTRY.name, &Shown::<Crafting>::NEW);
