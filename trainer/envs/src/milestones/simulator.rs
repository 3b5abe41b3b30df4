//! Many grids at once: resets, steps and states.

use alloc::vec;
use alloc::vec::Vec;
use core::marker::PhantomData;

use super::episode::{Episode, Standing};
use super::game::Game;
use super::rules::Rules;
use super::set::MilestoneSet;
use super::spec::spec;
use super::world::{ITEMS, World};
use crate::environment::{Split, Step, StepError};
use crate::random::{Random, below, chance};
use crate::spec::Spec;

/// What every step costs: a discount of 0.99, as the public code subtracts it.
const STEP_COST: f64 = 1.0 - 0.99;

/// Grids of a game, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Milestones<G: Game> {
    pub(super) rules: Rules,
    pub(super) spec: Spec,
    split: Split,
    pub(super) episodes: Vec<Episode>,
    game: PhantomData<G>,
}

impl<G: Game> Milestones<G> {
    /// Sets up so many instances, whose episodes are over.
    pub fn new(rules: Rules, instances: usize, split: Split) -> Self {
        let episode = Episode {
            world: World::new(G::SIZE),
            steps: 0,
            limit: 0,
            standing: Standing::Running,
            episode_return: 0.0,
            reached: 0,
            milestone: None,
        };
        let episodes = vec![episode; instances];
        Self { rules, spec: spec::<G>(&rules), split, episodes, game: PhantomData }
    }

    /// What the rules leave open.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// The grid of an instance.
    pub fn world(&self, instance: usize) -> &World {
        &self.episodes[instance].world
    }

    /// Starts an episode from a grid.
    pub fn start(&mut self, instance: usize, world: World) {
        let Rules { limit, training_limit, .. } = self.rules;
        let episode = &mut self.episodes[instance];
        *episode = Episode {
            world,
            steps: 0,
            limit: if self.split == Split::Train { training_limit } else { limit },
            standing: Standing::Running,
            episode_return: 0.0,
            reached: 0,
            milestone: None,
        };
    }

    /// Steps where `lost` says what gets lost behind the action: for replays.
    ///
    /// # Errors
    /// As [`Environment::step`](crate::Environment::step).
    pub fn step_losing(
        &mut self,
        instance: usize,
        action: u16,
        lost: impl FnOnce(&[u16; ITEMS]) -> Option<usize>,
    ) -> Result<Step, StepError> {
        let Rules { milestones, dense, .. } = self.rules;
        let episode = &mut self.episodes[instance];
        if episode.is_done() {
            return Err(StepError::EpisodeOver);
        }
        if usize::from(action) >= G::ACTIONS.len() {
            return Err(StepError::Unavailable { agent: 0, action });
        }
        let world = &mut episode.world;
        let reached = G::act(world, usize::from(action));
        if let Some(item) = lost(&world.inventory) {
            world.inventory[item] -= 1;
        }
        let reached = reached.filter(|milestone| milestones.bits() >> milestone & 1 == 1);
        let reward = reached.map_or(0.0, |it| worth::<G>(milestones, dense, episode.reached, it));
        let reward = reward - STEP_COST;
        episode.milestone = reached.and_then(|milestone| milestones.place(milestone));
        episode.reached |= reached.map_or(0, |milestone| 1 << milestone);
        episode.steps += 1;
        episode.episode_return += reward;
        episode.standing = if reached == Some(milestones.task()) {
            Standing::Solved
        } else if G::ENDS_IF_IMPOSSIBLE && !G::affords_any(world, milestones.bits()) {
            Standing::Impossible
        } else {
            Standing::Running
        };
        let terminated = episode.standing != Standing::Running;
        let timed_out = !terminated && episode.steps >= episode.limit;
        Ok(Step { reward, terminated, timed_out, tasks_changed: false })
    }

    pub(super) fn step_by_chance(
        &mut self,
        instance: usize,
        action: u16,
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let (loss, weights) = (self.rules.loss, G::LOSSES);
        self.step_losing(instance, action, |inventory| {
            let weights = weights.filter(|_| loss > 0.0 && chance(random, loss))?;
            drawn_item(inventory, &weights, random)
        })
    }
}

/// What a milestone is worth before the cost of its step.
fn worth<G: Game>(milestones: MilestoneSet, dense: bool, before: u16, reached: u8) -> f64 {
    let paid = milestones.bits() & G::PAID;
    match dense {
        false => f64::from(u8::from(reached == milestones.task())),
        true if (paid & !before) >> reached & 1 == 1 => 1.0 / f64::from(paid.count_ones()),
        true => 0.0,
    }
}

/// An item that is there, by the weights of its kind.
fn drawn_item(
    inventory: &[u16; ITEMS],
    weights: &[u32; ITEMS],
    random: &mut Random,
) -> Option<usize> {
    let weight = |item: usize| if inventory[item] > 0 { weights[item] as usize } else { 0 };
    let total = (0..ITEMS).map(weight).sum::<usize>();
    let mut left = below(random, total);
    (total > 0).then(|| {
        let is_it = |item: &usize| {
            let weight = weight(*item);
            let found = left < weight;
            left = left.saturating_sub(weight);
            found
        };
        (0..ITEMS).find(is_it).expect("the number is below the sum of the weights")
    })
}
