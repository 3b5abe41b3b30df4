//! Objects, items and milestones by their numbers.

/// Objects by their numbers.
pub(super) mod object {
    pub(crate) const RED_DOOR: u8 = 3;
    pub(crate) const YELLOW_DOOR: u8 = 4;
    pub(crate) const BLUE_DOOR: u8 = 5;
    pub(crate) const GREEN_DOOR: u8 = 6;
    pub(crate) const RED_KEY: u8 = 7;
    pub(crate) const YELLOW_KEY: u8 = 8;
    pub(crate) const PURPLE_KEY: u8 = 9;
    pub(crate) const GREEN_WEIGHT: u8 = 10;
    pub(crate) const GREEN_BUTTON: u8 = 11;
    pub(crate) const BLUE_KEY: u8 = 12;
    pub(crate) const PURPLE_CHEST: u8 = 13;
}

/// Items by their numbers.
pub(super) mod item {
    pub(crate) const RED_KEY: u8 = 0;
    pub(crate) const YELLOW_KEY: u8 = 1;
    pub(crate) const GREEN_WEIGHT: u8 = 2;
    pub(crate) const PRESSED: u8 = 3;
    pub(crate) const BLUE_KEY: u8 = 4;
    pub(crate) const PURPLE_KEY: u8 = 5;
    pub(crate) const TREASURE: u8 = 6;
}

/// Milestones by their numbers.
pub(super) mod milestone {
    pub(crate) const RED_KEY: u8 = 0;
    pub(crate) const YELLOW_KEY: u8 = 1;
    pub(crate) const RED_DOOR: u8 = 2;
    pub(crate) const YELLOW_DOOR: u8 = 3;
    pub(crate) const GREEN_WEIGHT: u8 = 4;
    pub(crate) const BLUE_KEY: u8 = 5;
    pub(crate) const BLUE_DOOR: u8 = 6;
    pub(crate) const GREEN_DOOR: u8 = 7;
    pub(crate) const PURPLE_KEY: u8 = 8;
    pub(crate) const TREASURE: u8 = 9;
}

/// Which key lies in the middle at the start, where only one does.
pub(super) mod case {
    pub(crate) const RED: u8 = 1;
    pub(crate) const YELLOW: u8 = 2;
}

/// Whether an object is a door.
pub(super) fn is_door(object: u8) -> bool {
    (object::RED_DOOR..=object::GREEN_DOOR).contains(&object)
}
