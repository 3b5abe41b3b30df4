//! What the games on such grids differ in.

use core::fmt::Debug;

use super::world::{ITEMS, World};
use crate::random::Random;

/// What an action did.
pub type Effect = Option<u8>;

/// The rules of one game.
pub trait Game: Clone + Copy + Debug + Default + Send + Sync + 'static {
    /// Its name, as `--env` takes it.
    const NAME: &'static str;
    /// What it is, in one sentence.
    const ABOUT: &'static str;
    /// Cells of a row, and rows.
    const SIZE: usize;
    /// Kinds of objects by their numbers: empty, agent and wall first.
    const OBJECTS: &'static [&'static str];
    /// States that objects can be in, by their numbers; none where all are alike.
    const STATES: &'static [&'static str];
    /// What can be carried, by its numbers.
    const ITEMS: &'static [&'static str];
    /// Names of the actions.
    const ACTIONS: &'static [&'static str];
    /// All milestones in their order.
    const MILESTONES: &'static [&'static str];
    /// How each milestone shows in what is carried: an item, and by how much its count changes.
    const SIGNS: &'static [(u8, i16)];
    /// Those that a dense reward pays for, as bits.
    const PAID: u16;
    /// Tasks: milestones that can be the last one.
    const TASKS: &'static [&'static str];
    /// How likely each item is to be the one that gets lost, where items can.
    const LOSSES: Option<[u32; ITEMS]>;
    /// Whether an episode is over where no milestone can be had any more.
    const ENDS_IF_IMPOSSIBLE: bool;

    /// Draws a start.
    fn draw(random: &mut Random) -> World;

    /// Takes an action; the milestone that it reached, if any.
    fn act(world: &mut World, action: usize) -> Effect;

    /// The number of the state that objects of a kind are in.
    fn state(world: &World, object: u8) -> u8;

    /// Of the milestones in use, as bits, those that can be next, without another one of them before.
    fn affordances(world: &World, used: u16) -> u16;

    /// Whether one of them can be had.
    fn affords_any(world: &World, used: u16) -> bool {
        Self::affordances(world, used) != 0
    }
}
