//! What the scenarios of the plane differ in.

use alloc::vec::Vec;
use core::fmt::Debug;

use super::bytes::Reader;
use super::columns::Row;
use super::picture::Picture;
use super::plane::Point;
use crate::random::Random;
use crate::spec::{Metric, Role};

/// The rules of one scenario for teams of one size.
pub trait Scenario: Clone + Debug + Send + Sync + 'static {
    /// What an episode has beside its steps and its return.
    type World: Clone + Debug + Send + Sync;
    /// What episodes come to.
    const METRICS: &'static [Metric];

    /// Its agents, by what they see and do.
    fn roles(&self) -> Vec<Role>;

    /// Steps of every episode.
    fn episode_limit(&self) -> u32;

    /// Any world, to be [reset](Self::reset).
    fn world(&self) -> Self::World;

    /// Draws the start of an episode.
    fn reset(&self, world: &mut Self::World, random: &mut Random);

    /// Plays one step with possible actions, and writes what each agent earns.
    fn step(
        &self,
        world: &mut Self::World,
        actions: &[u16],
        random: &mut Random,
        rewards: &mut [f64],
    );

    /// What an episode of so many steps has come to, in the order of the metrics.
    fn metrics(&self, world: &Self::World, steps: u32) -> Vec<Option<f64>>;

    /// Adds the bytes of a world, always equally many.
    fn write(&self, world: &Self::World, bytes: &mut Vec<u8>);

    /// Reads what [`write`](Self::write) wrote; what the reader has refused is not looked at.
    fn read(&self, bytes: &mut Reader<'_>) -> Self::World;

    /// Writes what an agent sees.
    fn observe(&self, world: &Self::World, agent: usize, row: &mut Row<'_>);

    /// Where an agent or a thing is, with its velocity if it has one; agents come first. None of those that are nowhere.
    fn entity<'w>(
        &self,
        world: &'w mut Self::World,
        entity: usize,
    ) -> Option<(&'w mut Point, Option<&'w mut Point>)>;

    /// What there is to draw of a world.
    fn picture(&self, world: &Self::World) -> Picture;

    /// Writes the actions of a team that knows the whole world.
    fn script(&self, world: &Self::World, actions: &mut [u16]);

    /// How far an agent is from what it should be at next, by which rewards are shaped.
    fn distance_to_go(&self, world: &Self::World, agent: usize) -> f64 {
        let _ = (world, agent);
        0.0
    }
}
