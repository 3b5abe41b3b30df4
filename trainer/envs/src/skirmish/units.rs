//! Types of units, by two rule books.

/// Types of units.
pub(super) const TYPES: usize = 6;
/// Their names. Units of a team are in this order.
pub(super) const TYPE_NAMES: [&str; TYPES] =
    ["colossus", "marauder", "marine", "medivac", "stalker", "zealot"];
pub(super) const COLOSSUS: u8 = 0;
pub(super) const MARAUDER: u8 = 1;
pub(super) const MARINE: u8 = 2;
pub(super) const MEDIVAC: u8 = 3;
pub(super) const STALKER: u8 = 4;
pub(super) const ZEALOT: u8 = 5;
