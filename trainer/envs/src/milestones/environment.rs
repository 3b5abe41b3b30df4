//! The games as [`Environment`]s, by their names: many grids at once.

use alloc::boxed::Box;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use alloc::{format, vec};
use core::iter;
use core::marker::PhantomData;

use serde::Deserialize;

use super::VERSION;
use super::observation::{IMPOSSIBLE, TIME, picture, spec, write_row};
use super::rules::{
    Episode, MilestoneSet, Rules, Standing, read_episode, read_sound, write_episode,
};
use super::world::{EMPTY, Game, ITEMS, World};
use crate::bytes::known;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Split, StateError, Step, StepError};
use crate::observation::{EntitySet, Observation};
use crate::picture::Picture;
use crate::random::{Random, below, chance};
use crate::spec::Spec;

/// What every step costs: a discount of 0.99, as the public code subtracts it.
const STEP_COST: f64 = 1.0 - 0.99;

/// Grids of a game, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Milestones<G: Game> {
    rules: Rules,
    spec: Spec,
    split: Split,
    episodes: Vec<Episode>,
    game: PhantomData<G>,
}

impl<G: Game> Milestones<G> {
    /// Sets up so many instances, whose episodes are over.
    pub fn new(rules: Rules, instances: usize, split: Split) -> Self {
        let episode = Episode::begins(World::new(G::SIZE), 0);
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
        let limit = if self.split == Split::Train { training_limit } else { limit };
        self.episodes[instance] = Episode::begins(world, limit);
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

/// How `--env` finds a game.
pub(crate) const fn entry<G: Game>() -> Entry {
    Entry {
        name: G::NAME,
        about: G::ABOUT,
        version: VERSION,
        sets: sets::<G>,
        open: |choice| Ok(Box::new(open::<G>(choice)?)),
        rules: &[],
        reader: None,
        #[cfg(feature = "std")]
        recordings: None,
    }
}

/// What can be set besides the task, which the name of the set says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    milestones: usize,
    milestones_seed: u64,
    dense: bool,
    loss: f64,
    limit: u16,
    training_limit: u16,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            milestones: 0,
            milestones_seed: 0,
            dense: false,
            loss: 0.0,
            limit: 0,
            training_limit: 1_500,
        }
    }
}

fn sets<G: Game>() -> Vec<String> {
    G::TASKS.iter().map(|task| (*task).to_string()).collect()
}

fn open<G: Game>(choice: &Choice<'_>) -> Result<Milestones<G>, EnvironmentError> {
    let settings: Settings = choice.settings()?;
    let refused = |reason: String| Err(EnvironmentError::Setting(reason));
    let task = choice.set.unwrap_or(G::TASKS[0]);
    let Some(all) = MilestoneSet::up_to::<G>(task).filter(|_| G::TASKS.contains(&task)) else {
        let known = G::TASKS.join("`, `");
        return Err(EnvironmentError::Set(format!("no task `{task}`; there are `{known}`")));
    };
    let count = if settings.milestones == 0 { all.len() } else { settings.milestones };
    let milestones = match all.drawn(count, settings.milestones_seed) {
        Ok(milestones) => milestones,
        Err(reason) => return refused(reason),
    };
    if !(0.0..=1.0).contains(&settings.loss) {
        let loss = settings.loss;
        return refused(format!("`loss` is {loss}, a probability from 0 to 1 is needed"));
    }
    if settings.loss > 0.0 && G::LOSSES.is_none() {
        return refused(
            "`loss` is not for this game: what is lost would be gone for good".to_string(),
        );
    }
    if settings.training_limit == 0 {
        return refused("`training_limit` is 0, at least 1 step is needed".to_string());
    }
    let usual = Rules::usual::<G>(milestones);
    let rules = Rules {
        dense: settings.dense,
        loss: settings.loss,
        limit: if settings.limit == 0 { usual.limit } else { settings.limit },
        training_limit: settings.training_limit,
        ..usual
    };
    Ok(Milestones::new(rules, choice.instances, choice.split))
}

impl<G: Game> Environment for Milestones<G> {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.episodes.len()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        Box::new(Self::new(self.rules, instances, split))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        self.start(instance, G::draw(random));
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        let action = actions.first().ok_or(StepError::TooFewActions { agents: 1, actions: 0 })?;
        let (loss, weights) = (self.rules.loss, G::LOSSES);
        self.step_losing(instance, *action, |inventory| {
            let weights = weights.filter(|_| loss > 0.0 && chance(random, loss))?;
            drawn_item(inventory, &weights, random)
        })
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        write_episode(&self.episodes[instance], state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let longest = self.rules.limit.max(self.rules.training_limit);
        self.episodes[instance] = read_sound::<G>(state, longest)?;
        Ok(())
    }

    fn picture(&self, state: &[u8]) -> Picture {
        picture::<G>(&known(read_episode::<G>(state)).world)
    }

    fn place(&mut self, instance: usize, entity: usize, place: [f64; 2]) -> Result<(), StateError> {
        let world = &mut self.episodes[instance].world;
        let [x, y] = place.map(|part| part as usize);
        let is_inside = entity == 0 && x.max(y) < world.size.into();
        if !is_inside || world.object(world.at(x, y)) != EMPTY {
            return Err(StateError::Impossible("the agent can stand in empty cells only".into()));
        }
        world.position = world.at(x, y) as u8;
        Ok(())
    }

    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        seen.begin_agents(1, G::ACTIONS.len(), wanted, |_| 1);
        if seen.entities != 0 {
            write_row::<G>(&known(read_episode::<G>(state)).world, turn == 1, &mut seen.rows);
        }
    }

    fn episode(&self, instance: usize) -> crate::Episode {
        let episode = &self.episodes[instance];
        let timed_out = episode.standing == Standing::Running && episode.steps >= episode.limit;
        // How many milestones were reached, and for each whether it was; nothing of those that are not in use.
        let (used, reached) = (self.rules.milestones.bits(), episode.reached);
        let is = |set: u16, milestone: usize| set >> milestone & 1;
        let own = (0..G::MILESTONES.len())
            .map(|milestone| (is(used, milestone) == 1).then(|| f64::from(is(reached, milestone))));
        let count = f64::from(reached.count_ones());
        crate::Episode {
            steps: episode.steps.into(),
            done: episode.is_done(),
            solved: episode.standing == Standing::Solved,
            timed_out,
            episode_return: episode.episode_return,
            group: String::new(),
            metrics: iter::once(Some(count)).chain(own).collect(),
            cause: match episode.standing {
                Standing::Impossible => Some(IMPOSSIBLE),
                Standing::Running if timed_out => Some(TIME),
                _ => None,
            },
        }
    }

    /// In the mirror left is right.
    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        if turn == 1 && action < 2 { 1 - action } else { action }
    }

    fn milestone(&self, instance: usize) -> Option<usize> {
        self.episodes[instance].milestone.map(usize::from)
    }

    fn affordances(&self, state: &[u8]) -> Option<u32> {
        let (world, milestones) = (known(read_episode::<G>(state)).world, self.rules.milestones);
        Some(milestones.places(G::affordances(&world, milestones.bits())))
    }
}
