//! What every [`Environment`] must hold to, as a test that any environment can run.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;

use crate::environment::{Environment, Split, Step};
use crate::observation::{ActionSet, EntitySet, Observation, TaskSet, members};
use crate::random::{Random, generator, member};
use crate::rows::SparseRows;
use crate::spec::Spec;

/// Plays episodes of random actions and checks the laws of [`Environment`] in every state.
///
/// # Errors
/// The first law that does not hold, with what was found.
pub fn check(environment: &dyn Environment, seed: u64, episodes: usize) -> Result<(), String> {
    environment.spec().check().map_err(|error| error.to_string())?;
    let mut random = generator(seed);
    let mut law = Laws {
        played: environment.open(2, Split::Train),
        other: environment.open(1, Split::Test),
        spec: environment.spec().clone(),
        seen: Observation::new(&environment.spec().shape),
    };
    require(law.played.instances() == 2, || "`open` gives as many instances as asked for".into())?;
    (0..episodes).try_for_each(|episode| {
        law.play(episode % 2, &mut random).map_err(|error| format!("episode {episode}: {error}"))
    })
}

struct Laws {
    played: alloc::boxed::Box<dyn Environment>,
    /// Instance 0 continues from saved states.
    other: alloc::boxed::Box<dyn Environment>,
    spec: Spec,
    seen: Observation,
}

fn require(holds: bool, law: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(law()) }
}

impl Laws {
    fn play(&mut self, instance: usize, random: &mut Random) -> Result<(), String> {
        self.played.reset(instance, random);
        let start = self.played.episode(instance);
        require(start.steps == 0 && start.episode_return == 0.0, || "a reset starts anew".into())?;
        self.check_places(&self.saved(instance)?)?;
        let (mut returned, mut first) = (0.0, None);
        while !self.played.episode(instance).done {
            let state = self.saved(instance)?;
            self.check_observation(&state)?;
            let fixed = fixed(&self.spec, &self.seen);
            require(*first.get_or_insert(fixed.clone()) == fixed, || {
                format!("not all of the first {} columns of things stay", self.spec.fixed)
            })?;
            let actions = self.random_actions(random);
            let step = self.step_twice(instance, &state, &actions, random)?;
            returned += step.reward;
            let episode = self.played.episode(instance);
            require(episode.done == step.done(), || "an episode is done as its step says".into())?;
            require(episode.metrics.len() == self.spec.metrics.len(), || {
                format!("{} values for {} metrics", episode.metrics.len(), self.spec.metrics.len())
            })?;
            require(episode.steps <= self.spec.episode_limit, || {
                format!("step {} of at most {}", episode.steps, self.spec.episode_limit)
            })?;
        }
        let episode = self.played.episode(instance);
        let error = (episode.episode_return - returned).abs();
        require(error < 1e-9 * (1.0 + returned.abs()), || {
            format!(
                "rewards add up to {returned}, the episode's return is {}",
                episode.episode_return
            )
        })?;
        let actions = vec![0; self.spec.shape.agents];
        let refused = self.played.step(instance, &actions, random);
        require(refused.is_err(), || "an episode that is over takes no step".into())
    }

    fn saved(&self, instance: usize) -> Result<Vec<u8>, String> {
        let mut state = Vec::new();
        self.played.save(instance, &mut state);
        require(state.len() <= self.spec.state_bytes, || {
            format!(
                "a state of {} bytes, at most {} are promised",
                state.len(),
                self.spec.state_bytes
            )
        })?;
        Ok(state)
    }

    /// Whatever is put elsewhere leaves a state that an episode goes on from; where that is refused nothing has changed.
    fn check_places(&mut self, state: &[u8]) -> Result<(), String> {
        self.other.load(0, state).map_err(|error| format!("a saved state is refused: {error}"))?;
        let places = [[0.0; 2], [1.0, 2.0], [5.0, 1.0], [-1.0, 1.0], [1e300; 2], [f64::NAN; 2]];
        let mut before = state.to_vec();
        for entity in 0..=self.spec.shape.entities {
            for place in places {
                let placed = self.other.place(0, entity, place);
                let mut after = Vec::new();
                self.other.save(0, &mut after);
                require(placed.is_ok() || after == before, || {
                    format!("entity {entity} is not put to {place:?}, but something has changed")
                })?;
                require(!self.other.episode(0).done, || {
                    format!("the episode is over by putting entity {entity} to {place:?}")
                })?;
                self.other.load(0, &after).map_err(|error| {
                    format!("no episode goes on from entity {entity} at {place:?}: {error}")
                })?;
                before = after;
            }
        }
        Ok(())
    }

    /// Takes the same step in a copy of the state, and in the instance itself.
    fn step_twice(
        &mut self,
        instance: usize,
        state: &[u8],
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, String> {
        self.other.load(0, state).map_err(|error| format!("a saved state is refused: {error}"))?;
        let mut again = Vec::new();
        self.other.save(0, &mut again);
        require(again == state, || "a loaded state is saved as it was".into())?;

        let mut same_random = random.clone();
        let copied = self.other.step(0, actions, &mut same_random);
        let step = self.played.step(instance, actions, random);
        require(copied == step, || format!("a copy steps otherwise: {copied:?} and {step:?}"))?;
        require(same_random == *random, || "a copy draws otherwise".into())?;
        let rewards = (self.played.task_rewards(instance), self.other.task_rewards(0));
        let tasks = if self.spec.rewards.tasks { self.spec.shape.tasks } else { 0 };
        require(rewards.0 == rewards.1 && rewards.0.len() == tasks, || {
            format!("rewards of {tasks} subtasks: {rewards:?}")
        })?;
        let rewards = (self.played.agent_rewards(instance), self.other.agent_rewards(0));
        let agents = if self.spec.rewards.agents { self.spec.shape.agents } else { 0 };
        require(rewards.0 == rewards.1 && rewards.0.len() == agents, || {
            format!("rewards of {agents} agents: {rewards:?}")
        })?;
        let (episode, copy) = (self.played.episode(instance), self.other.episode(0));
        require(episode == copy, || format!("a copy counts otherwise: {episode:?} and {copy:?}"))?;
        step.map_err(|error| format!("an available action is refused: {error}"))
    }

    fn check_observation(&mut self, state: &[u8]) -> Result<(), String> {
        let shape = self.spec.shape;
        self.played.observe(state, 0, EntitySet::MAX, &mut self.seen);
        let seen = &self.seen;
        require(seen.entities == seen.present, || "all that exists was asked for".into())?;
        let rows = seen.rows.len();
        require(rows == seen.present.count_ones() as usize, || format!("{rows} rows"))?;
        let lengths = [seen.observable.len(), seen.available.len(), seen.entity_task.len()];
        require(lengths == [shape.agents, shape.agents, shape.entities], || {
            format!("masks of {lengths:?}")
        })?;
        for (row, entity) in members(seen.present).enumerate() {
            let entries: Vec<_> = seen.rows.row(row).collect();
            require(entries.len() <= self.spec.row_entries, || {
                format!(
                    "{} features in a row, at most {} are promised",
                    entries.len(),
                    self.spec.row_entries
                )
            })?;
            require(entries.is_sorted_by(|one, next| one.0 < next.0), || {
                format!("features out of order: {entries:?}")
            })?;
            let features = self.spec.features_of(entity).len();
            let sound = |(column, value): &(usize, f32)| *column < features && value.is_finite();
            require(entries.iter().all(sound), || format!("impossible features: {entries:?}"))?;
        }
        let within = |tasks: TaskSet| tasks >> shape.tasks == 0;
        require(
            within(seen.open_tasks) && seen.entity_task.iter().all(|tasks| within(*tasks)),
            || "subtasks beyond the shape".into(),
        )?;
        let agents = seen.agents();
        require(u128::from(seen.absent) >> agents == 0, || {
            format!("{agents} agents exist, of which {:b} are absent", seen.absent)
        })?;
        for (agent, available) in seen.available.iter().enumerate() {
            let actions = self.spec.actions_of(agent).len();
            let possible = *available != 0 && (*available) >> actions == 0;
            require(possible && (agent < agents || *available == 1), || {
                format!("agent {agent} may do {available:b}")
            })?;
            let acts = agent >= agents || seen.acting() >> agent & 1 == 1;
            require(acts || available.is_power_of_two(), || {
                format!("agent {agent} is absent, but may do {available:b}")
            })?;
            let blind = unseen_target(&self.spec, seen, agent);
            require(blind.is_none(), || {
                format!("agent {agent} may aim at entity {blind:?}, which it does not observe")
            })?;
            let told = told_of_unseen(&self.spec, seen, agent);
            require(told.is_none(), || {
                format!("agent {agent} is told of entity {told:?}, which it does not observe")
            })?;
        }
        self.check_picture(state)?;
        self.check_offers(state)?;
        self.check_relations(state)?;
        self.check_parts(state)
    }

    /// A picture has the agents that exist, things of subtasks that exist, and links between what it has.
    fn check_picture(&self, state: &[u8]) -> Result<(), String> {
        let picture = self.played.picture(state);
        let (agents, shown) = (self.seen.agents(), picture.agents.len());
        require(shown == agents, || format!("{shown} agents are shown of {agents}"))?;
        let tasks = self.spec.shape.tasks;
        let unknown = picture.things.iter().find(|thing| thing.task.is_some_and(|it| it >= tasks));
        require(unknown.is_none(), || format!("{unknown:?} stands for no subtask"))?;
        let is_known = |entity: usize| picture.entity(entity).is_some();
        let loose = picture.links.iter().find(|link| !is_known(link.from) || !is_known(link.to));
        require(loose.is_none(), || format!("{loose:?} links what is not there"))?;
        let shares = picture.agents.iter().chain(&picture.things).flat_map(|disc| &disc.bars);
        let wrong = shares.copied().find(|bar| !(0.0..=1.0).contains(&bar.share));
        require(wrong.is_none(), || format!("{wrong:?} is no share"))
    }

    /// Who acts can be given what is open and nothing else.
    fn check_offers(&self, state: &[u8]) -> Result<(), String> {
        let mut offers = Vec::new();
        let alone = self.played.offers(state, &mut offers);
        let (open, acting) = (self.seen.open_tasks, self.seen.acting());
        let is_sound = |(agent, offer): (usize, &TaskSet)| {
            offer & !open == 0 && (*offer == 0 || acting >> agent & 1 == 1)
        };
        let agents = offers.len() == self.spec.shape.agents;
        require(agents && offers.iter().enumerate().all(is_sound), || {
            format!("{open:b} are open, agents are offered {offers:?}")
        })?;
        require(alone >> self.spec.shape.tasks == 0, || {
            format!("subtasks {alone:b} are for one agent alone")
        })
    }

    /// Every entity stands somehow to every subtask.
    fn check_relations(&self, state: &[u8]) -> Result<(), String> {
        let (mut rows, entities) = (SparseRows::default(), self.seen.rows.len());
        for task in 0..self.spec.shape.tasks {
            rows.clear();
            self.played.relate(state, 0, task, EntitySet::MAX, &mut rows);
            let columns = (0..rows.len()).flat_map(|row| rows.row(row));
            let most = columns.map(|(column, _)| column + 1).max().unwrap_or(0);
            require(rows.len() == entities && most <= self.spec.relations, || {
                format!(
                    "{} rows of {most} columns relate {entities} entities to subtask {task}",
                    rows.len()
                )
            })?;
            let first = members(self.seen.things_of(task)).next();
            let asks = first.map(|thing| self.seen.row_of(thing));
            require(asks.is_none_or(|row| rows.row(row).next().is_none()), || {
                format!("the first thing of subtask {task} is related to it, but it asks")
            })?;
        }
        Ok(())
    }

    /// Rows alone, and under every symmetry, are those of the whole.
    fn check_parts(&mut self, state: &[u8]) -> Result<(), String> {
        let mut part = Observation::new(&self.spec.shape);
        for entity in members(self.seen.present) {
            self.played.observe(state, 0, 1 << entity, &mut part);
            let (whole, row) = (&self.seen, self.seen.row_of(entity));
            require(
                part.entities == 1 << entity && part.rows.row(0).eq(whole.rows.row(row)),
                || format!("the row of entity {entity} alone is another one"),
            )?;
        }
        for turn in 0..self.spec.turns {
            self.played.observe(state, turn, EntitySet::MAX, &mut part);
            for (agent, (plain, turned)) in
                self.seen.available.iter().zip(&part.available).enumerate()
            {
                let mapped = (0..self.spec.shape.actions as u16)
                    .filter(|action| plain >> action & 1 == 1)
                    .map(|action| 1 << self.played.turned_action(turn, action))
                    .fold(0, |set: ActionSet, action| set | action);
                require(mapped == *turned, || {
                    format!("turn {turn}: agent {agent} may do {turned:b}")
                })?;
            }
        }
        Ok(())
    }

    fn random_actions(&self, random: &mut Random) -> Vec<u16> {
        let choose = |set: &ActionSet| member(random, *set).unwrap_or(0) as u16;
        self.seen.available.iter().map(choose).collect()
    }
}

/// By things: what is said to stay as it is; nothing where that is said of nothing.
fn fixed(spec: &Spec, seen: &Observation) -> Vec<(usize, Vec<(usize, f32)>)> {
    let columns = |thing| {
        let row = seen.rows.row(seen.row_of(thing));
        row.filter(|(column, _)| *column < spec.fixed).collect()
    };
    let things = if spec.fixed == 0 { 0 } else { seen.things() & seen.entities };
    members(things).map(|thing| (thing, columns(thing))).collect()
}

/// An entity that an agent may aim at and does not observe.
fn unseen_target(spec: &Spec, seen: &Observation, agent: usize) -> Option<usize> {
    let observed = seen.observable[agent] & seen.present;
    let mut targets = members(seen.available[agent]).filter_map(|action| spec.target_of(action));
    targets.find(|target| observed >> target & 1 == 0)
}

/// A target that an agent does not observe, of which its own row says how they stand to each other.
fn told_of_unseen(spec: &Spec, seen: &Observation, agent: usize) -> Option<usize> {
    if seen.present >> agent & 1 == 0 {
        return None;
    }
    let observed = seen.observable[agent] & seen.present;
    let mut unseen = spec.targets.clone().enumerate().filter(|(_, it)| observed >> it & 1 == 0);
    let row = || seen.rows.row(seen.row_of(agent)).filter(|(_, value)| *value != 0.0);
    let is_told =
        |target: &usize| row().any(|(column, _)| spec.pair_columns(*target).contains(&column));
    unseen.find(|(target, _)| is_told(target)).map(|(_, entity)| entity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::{Shape, SpecError};

    /// Two actions that aim at nobody, then one for each of the entities 1 to 3.
    fn spec() -> Spec {
        let shape = Shape { agents: 2, entities: 4, tasks: 0, actions: 5, features: 1 };
        let names = |count: usize| (0..count).map(|index| index.to_string()).collect();
        Spec { shape, features: names(1), actions: names(5), targets: 1..4, ..Spec::default() }
    }

    #[test]
    fn aimed_actions_are_the_last_ones_and_aim_at_entities() {
        assert_eq!(spec().check(), Ok(()));
        let targets = [0, 1, 2, 3, 4, 5].map(|action| spec().target_of(action));
        assert_eq!(targets, [None, None, Some(1), Some(2), Some(3), None]);
        let refused = |targets| Spec { targets, ..spec() }.check().unwrap_err();
        let what = "entities up to the last target";
        assert_eq!(refused(2..5), SpecError::Size { what, found: 5, least: 0, most: 4 });
        let crowded = Spec { shape: Shape { actions: 3, ..spec().shape }, ..spec() };
        let crowded = Spec { actions: spec().actions[..3].to_vec(), ..crowded };
        let what = "aimed actions";
        assert_eq!(crowded.check(), Err(SpecError::Size { what, found: 3, least: 0, most: 2 }));
    }

    /// Two features of each of three pairs behind one of the agent's own.
    fn paired() -> Spec {
        let features = (0..7).map(|index| index.to_string()).collect();
        Spec { shape: Shape { features: 7, ..spec().shape }, features, pairs: 1..7, ..spec() }
    }

    #[test]
    fn pairs_have_as_many_features_each() {
        assert_eq!(paired().check(), Ok(()));
        assert_eq!((spec().pair_features(), paired().pair_features()), (0, 2));
        assert_eq!([0, 2].map(|target| paired().pair_columns(target)), [1..3, 5..7]);
        let refused = |pairs| Spec { pairs, ..paired() }.check().unwrap_err();
        let what = "features up to the last pair's";
        assert_eq!(refused(2..8), SpecError::Size { what, found: 8, least: 0, most: 7 });
        let what = "features of pairs, as many for each target";
        assert_eq!(refused(1..6), SpecError::Names { what, found: 5, wanted: 3 });
        let alone = Spec { targets: 0..0, ..paired() };
        assert_eq!(alone.check(), Err(SpecError::Names { what, found: 6, wanted: 0 }));
    }

    #[test]
    fn nobody_is_told_of_what_it_does_not_observe() {
        let mut seen = Observation::new(&paired().shape);
        (seen.present, seen.entities) = (0b1111, 0b1111);
        seen.observable = vec![0b0111, 0b1111];
        let mut told = |columns: &[usize]| {
            seen.rows.clear();
            columns.iter().for_each(|column| seen.rows.push(*column, 1.0));
            (0..4).for_each(|_| seen.rows.end_row());
            told_of_unseen(&paired(), &seen, 0)
        };
        assert_eq!([told(&[0, 1, 2, 3, 4]), told(&[5]), told(&[0, 6])], [None, Some(3), Some(3)]);
        (seen.present, seen.entities) = (0b1110, 0b1110);
        assert_eq!(told_of_unseen(&paired(), &seen, 0), None);
    }

    #[test]
    fn nobody_aims_at_what_it_does_not_observe() {
        let mut seen = Observation::new(&spec().shape);
        seen.present = 0b1111;
        seen.observable = vec![0b0111, 0b1111];
        seen.available = vec![0b01101, 0b11111];
        assert_eq!([0, 1].map(|agent| unseen_target(&spec(), &seen, agent)), [None, None]);
        seen.available[0] |= 0b10000;
        assert_eq!(unseen_target(&spec(), &seen, 0), Some(3));
        seen.present = 0b0111;
        assert_eq!(unseen_target(&spec(), &seen, 1), Some(3));
    }
}
