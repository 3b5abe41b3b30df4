//! Objects, items and milestones by their numbers.

/// Objects by their numbers.
pub(super) mod object {
    pub(crate) const DIRT: u8 = 3;
    pub(crate) const TREE: u8 = 4;
    pub(crate) const STONE: u8 = 5;
    pub(crate) const COAL: u8 = 6;
    pub(crate) const IRON_ORE: u8 = 7;
    pub(crate) const DIAMOND: u8 = 8;
    pub(crate) const BENCH: u8 = 9;
    pub(crate) const FURNACE: u8 = 10;
}

/// Items by their numbers.
pub(super) mod item {
    pub(crate) const LOG: u8 = 0;
    pub(crate) const DIRT: u8 = 1;
    pub(crate) const WOOD: u8 = 2;
    pub(crate) const STICK: u8 = 3;
    pub(crate) const STONE: u8 = 4;
    pub(crate) const WOOD_PICKAXE: u8 = 5;
    pub(crate) const STONE_PICKAXE: u8 = 6;
    pub(crate) const IRON_PICKAXE: u8 = 7;
    pub(crate) const IRON_ORE: u8 = 8;
    pub(crate) const IRON: u8 = 9;
    pub(crate) const COAL: u8 = 10;
    pub(crate) const DIAMOND: u8 = 11;
}

/// Milestones by their numbers.
pub(super) mod milestone {
    pub(crate) const LOG: u8 = 0;
    pub(crate) const WOOD: u8 = 1;
    pub(crate) const STICK: u8 = 2;
    pub(crate) const BENCH: u8 = 3;
    pub(crate) const WOOD_PICKAXE: u8 = 4;
    pub(crate) const STONE: u8 = 5;
    pub(crate) const FURNACE: u8 = 6;
    pub(crate) const STONE_PICKAXE: u8 = 7;
    pub(crate) const IRON_ORE: u8 = 8;
    pub(crate) const COAL: u8 = 9;
    pub(crate) const IRON: u8 = 10;
    pub(crate) const IRON_PICKAXE: u8 = 11;
    pub(crate) const DIAMOND: u8 = 12;
}
