//! The games as [`Environment`]s, by their names.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::iter;

use serde::Deserialize;

use super::VERSION;
use super::episode::Standing;
use super::game::Game;
use super::rules::Rules;
use super::set::MilestoneSet;
use super::simulator::Milestones;
use super::spec::{IMPOSSIBLE, TIME};
use super::states;
use super::window;
use super::world::{EMPTY, World};
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{EntitySet, Observation};
use crate::random::Random;
use crate::spec::Spec;

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
        return refused(format!(
            "`loss` is {}, a probability from 0 to 1 is needed",
            settings.loss
        ));
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

impl<G: Game> Milestones<G> {
    /// The grid of a state that has been checked before.
    #[inline]
    fn known(&self, state: &[u8]) -> World {
        assert_eq!(state.len(), self.spec.state_bytes, "a state that `load` refuses");
        states::read_world::<G>(state)
    }

    /// How many milestones were reached, and for each of the game whether it was; nothing of those that are not in use.
    fn metrics(&self, reached: u16) -> Vec<Option<f64>> {
        let used = self.rules.milestones.bits();
        let is = |set: u16, milestone: usize| set >> milestone & 1;
        let own = (0..G::MILESTONES.len())
            .map(|milestone| (is(used, milestone) == 1).then(|| f64::from(is(reached, milestone))));
        iter::once(Some(f64::from(reached.count_ones()))).chain(own).collect()
    }
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
        self.step_by_chance(instance, *action, random)
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        states::write(&self.episodes[instance], state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let longest = self.rules.limit.max(self.rules.training_limit);
        self.episodes[instance] = states::read::<G>(state, longest)?;
        Ok(())
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
        seen.present = 1;
        seen.entities = wanted & 1;
        seen.observable.clear();
        seen.observable.push(1);
        seen.entity_task.clear();
        seen.entity_task.push(0);
        seen.available.clear();
        seen.available.push((1 << G::ACTIONS.len()) - 1);
        seen.open_tasks = 0;
        seen.rows.clear();
        if seen.entities != 0 {
            window::write::<G>(&self.known(state), turn == 1, &mut seen.rows);
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let episode = &self.episodes[instance];
        let timed_out = episode.standing == Standing::Running && episode.steps >= episode.limit;
        Episode {
            steps: episode.steps.into(),
            done: episode.is_done(),
            solved: episode.standing == Standing::Solved,
            timed_out,
            episode_return: episode.episode_return,
            group: String::new(),
            metrics: self.metrics(episode.reached),
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
        let milestones = self.rules.milestones;
        Some(milestones.places(G::affordances(&self.known(state), milestones.bits())))
    }
}
