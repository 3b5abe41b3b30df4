//! Skirmishes: teams of units fight by rules in the manner of StarCraft II, in the open or around a base.

mod battle;
mod fight;
mod moving;
mod orders;
#[cfg(test)]
mod tests;
mod units;
