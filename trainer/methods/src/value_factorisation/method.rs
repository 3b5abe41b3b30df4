//! Value factorisation as a [`Method`].

use std::ops::Range;

use sortie_envs::random::below;
use sortie_envs::{EntitySet, Environment, Random, Spec, members};
use sortie_learn::export::DeployedAgents;
use sortie_learn::learner::Rules;
use sortie_learn::networks::{Acting, Greedy, Moment, deployed};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports, UpdateReport};
use sortie_learn::session::Opening;
use sortie_learn::trajectory::{Capacity, Episode, Place, Widths};
use sortie_learn::{Act, Ask, LearnError, Learner, Method, Now, State, Trajectories, Transition};

use super::loss::{Lesson, Networks};
use super::{Config, ReplayConfig, ReturnsConfig, Unit};

/// Records of a shard: so many rows fit into the processor's nearest cache.
const RECORDS: usize = 32;
/// States of a shard of whole episodes, one episode at least. Many share their rows.
const STATES: usize = 128;

/// Agents that learn from the team's reward, and what they have seen.
#[derive(Debug)]
pub struct ValueFactorisation {
    config: Config,
    networks: Networks,
    learner: Learner<Lesson>,
    replay: Trajectories,
    /// Draws records and partitions.
    random: Random,
    acting: Acting,
    /// Updates that came due, also while there was too little to learn from.
    due: u64,
    /// Environment steps before the first update.
    first: u64,
    episodes: Vec<Episode>,
    drawn: Vec<Drawn>,
    shards: Vec<Range<usize>>,
}

/// What is learned from, and the part of the partition that is imagined in it.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    /// A whole episode, or a state as one of no steps.
    episode: Episode,
    part: EntitySet,
    /// The symmetry by which it is shown.
    turn: usize,
}

impl ValueFactorisation {
    /// Draws the first weights.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, environment, seed, threads } = *opening;
        let spec = environment.spec();
        let instances = setup.environment.instances;
        let mut weights = generator(seed, Purpose::Weights, 0);
        let (networks, parameters) = Networks::new(config.shape(spec), &mut weights);
        let (rule, target_every) = (config.update.rule, config.update.target_every);
        let rules = Rules { rule, target_every, ..Rules::from(&config.optimiser) };
        let capacity = match config.replay.unit {
            Unit::Steps => Capacity::States(config.replay.capacity / instances),
            Unit::Episodes => Capacity::Episodes(config.replay.capacity),
        };
        let widths = Widths { agents: spec.shape.agents, ..Widths::default() };
        // Every instance needs to have played for longer than a record looks ahead.
        let first = (4 * config.returns.steps * instances).max(config.replay.batch) as u64;
        Self {
            learner: Learner::new(parameters, rules, threads),
            networks,
            replay: Trajectories::new(capacity, instances, widths),
            random: generator(seed, Purpose::Replay, 0),
            acting: Acting::default(),
            due: 0,
            first,
            episodes: Vec::new(),
            drawn: Vec::new(),
            shards: Vec::new(),
            config,
        }
    }

    /// Makes an update.
    fn learn(&mut self, environment: &dyn Environment, learning_rate: f32) -> UpdateReport {
        let records = self.draw(environment.spec());
        let Self { config, networks, learner, replay, drawn, shards, .. } = self;
        let imagination = &config.imagination;
        let imagined = imagination.partitions.imagines().then_some(imagination.share);
        let gathering = Gathering { config, replay, environment };
        learner.update(shards.len(), learning_rate, |shard| {
            gathering.fill(shard.space, &drawn[shards[shard.number].clone()]);
            networks.loss(shard, imagined, records)
        })
    }

    /// Draws what an update learns from; returns how many records that are.
    fn draw(&mut self, spec: &Spec) -> usize {
        let Self { config, replay, random, episodes, drawn, shards, .. } = self;
        let (batch, partitions) = (config.replay.batch, config.imagination.partitions);
        let turns = if config.replay.symmetries { spec.turns } else { 1 };
        let shown = |episode, random: &mut Random| {
            let part = partitions.draw(spec.shape.entities, random);
            // Where nothing is symmetric nothing is drawn.
            let turn = if turns > 1 { below(random, turns) } else { 0 };
            Drawn { episode, part, turn }
        };
        drawn.clear();
        if config.replay.unit == Unit::Steps {
            drawn.extend((0..batch).map(|_| {
                let first = replay.draw(config.returns.steps, random);
                shown(Episode { first, steps: 0 }, random)
            }));
            cut(drawn, RECORDS, |_| 1, shards);
            return batch;
        }
        replay.draw_episodes(batch, random, episodes);
        drawn.extend(episodes.iter().map(|episode| shown(*episode, random)));
        // Episodes of about one length go through time together.
        drawn.sort_by_key(|drawn| drawn.episode.steps);
        cut(drawn, STATES, |drawn| drawn.episode.steps + 1, shards);
        drawn.iter().map(|drawn| drawn.episode.steps).sum()
    }
}

/// Cuts a list into ranges of about so many states, at least one item each.
fn cut<T>(items: &[T], most: usize, states: impl Fn(&T) -> usize, ranges: &mut Vec<Range<usize>>) {
    ranges.clear();
    let mut sum = most;
    for (index, item) in items.iter().enumerate() {
        sum += states(item);
        match ranges.last_mut() {
            Some(range) if sum <= most => range.end = index + 1,
            _ => {
                ranges.push(index..index + 1);
                sum = states(item);
            }
        }
    }
}

/// What lessons are made of.
struct Gathering<'a> {
    config: &'a Config,
    replay: &'a Trajectories,
    environment: &'a dyn Environment,
}

impl Gathering<'_> {
    /// Looks at what was drawn.
    fn fill(&self, lesson: &mut Lesson, drawn: &[Drawn]) {
        lesson.clear();
        let is_whole = self.config.replay.unit == Unit::Episodes;
        // The states of an episode are alike in most of their rows.
        lesson.before.share_rows(is_whole);
        for (number, drawn) in drawn.iter().enumerate() {
            if is_whole {
                self.add_episode(lesson, number, *drawn);
            } else {
                self.add_record(lesson, *drawn);
            }
        }
        let targets = self.config.network.head.targets(self.environment.spec());
        for batch in [&mut lesson.before, &mut lesson.after] {
            batch.aim_at(targets.entities(), targets.pairs());
        }
        lesson.before.finish(self.config.imagination.partitions.imagines());
        lesson.after.finish(false);
    }

    /// A state, and the one some steps later.
    fn add_record(&self, lesson: &mut Lesson, drawn: Drawn) {
        let ReturnsConfig { steps, discount, scale } = self.config.returns;
        let (number, first) = (lesson.rewards.len(), drawn.episode.first);
        self.add_state(lesson, (first, Moment { step: 0, episode: number }), drawn);
        let future = self.replay.future(first, steps, discount);
        lesson.rewards.push(scale * future.reward);
        lesson.discounts.push(future.discount);
        lesson.next.push(Some(number as u32));
        let seen = &mut lesson.seen;
        let state = self.replay.state(future.place);
        self.environment.observe(state, drawn.turn, EntitySet::MAX, seen);
        lesson.after.push(seen);
    }

    /// The states of a whole episode.
    fn add_episode(&self, lesson: &mut Lesson, number: usize, drawn: Drawn) {
        let ReturnsConfig { steps, discount, scale } = self.config.returns;
        let episode = drawn.episode;
        let start = lesson.rewards.len();
        for step in 0..=episode.steps {
            let place = episode.first.after(step);
            self.add_state(lesson, (place, Moment { step, episode: number }), drawn);
            let future = self.replay.future(place, steps, discount);
            let ahead = (step < episode.steps).then(|| start + future.place.since(episode.first));
            lesson.next.push(ahead.map(|ahead| ahead as u32));
            lesson.rewards.push(scale * future.reward);
            lesson.discounts.push(future.discount);
        }
    }

    /// Adds a state, what was done in it, and a part of its entities.
    fn add_state(&self, lesson: &mut Lesson, (place, moment): (Place, Moment), drawn: Drawn) {
        let Drawn { part, turn, .. } = drawn;
        let partitions = self.config.imagination.partitions;
        let Lesson { before, seen, companions, actions, .. } = lesson;
        let state = self.replay.state(place);
        self.environment.observe(state, turn, EntitySet::MAX, seen);
        companions.resize(self.environment.spec().shape.agents, EntitySet::MAX);
        if partitions.needs_companions() {
            self.environment.companions(state, companions);
        }
        before.push_at(moment, seen, |agent| partitions.within(part, companions[agent], agent));
        let done = self.replay.actions(place);
        let action = |agent: usize| self.environment.turned_action(turn, done[agent]);
        actions.extend(members(seen.acting().into()).map(|agent| u32::from(action(agent))));
    }
}

impl Method for ValueFactorisation {
    /// Who learns from whole episodes plays them in rounds, as in the public code.
    fn waits(&self) -> bool {
        self.config.replay.unit == Unit::Episodes
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        let exploration = &self.config.exploration;
        let epsilon = exploration.epsilon_at(now.env_steps);
        let factor = |instance: usize| exploration.spread[instance % exploration.spread.len()];
        let chances = scenes.scenes.iter().map(|scene| (epsilon * factor(scene.instance)).min(1.0));
        let teams = chances.zip(scenes.generators(random));
        self.acting.look(scenes);
        let network = (&self.networks.agents, &*self.learner.online.values);
        self.acting.explore(network, teams, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.replay.push(transition);
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let due = match self.config.replay.steps_per_update {
            0 => self.replay.finished(),
            every => now.env_steps.saturating_sub(self.first) / every,
        };
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        let ReplayConfig { unit, batch, .. } = self.config.replay;
        let has_batch = unit == Unit::Steps || self.replay.episodes() >= batch;
        let mut reports = Reports::default();
        while self.due < due {
            self.due += 1;
            if has_batch {
                reports.agents.push(self.learn(environment, learning_rate));
            }
        }
        Ok(reports)
    }

    fn rates(&self, now: Now) -> Rates {
        let epsilon = self.config.exploration.epsilon_at(now.env_steps);
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy::new(&self.networks.agents, &self.learner.average))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state(state)?;
        state.value("due", &mut self.due)?;
        state.value("random", &mut self.random)?;
        if self.config.network.memory > 0 {
            state.value("memories", &mut self.acting.memories)?;
        }
        self.replay.visit(state)
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Ok(deployed(&self.networks.agents, &self.learner.average))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use sortie_envs::random::member;
    use sortie_envs::{Observation, Split, Step};
    use sortie_learn::run::UpdateReport;

    use super::*;
    use crate::value_factorisation::VDN;

    fn ring() -> Box<dyn Environment> {
        sortie_envs::open("group-matching/4x3x2", Split::Train, 1, &Default::default()).unwrap()
    }

    /// A method that has seen nothing yet, with these changes of its settings.
    fn new(ring: &dyn Environment, batch: usize, change: fn(&mut Config)) -> ValueFactorisation {
        let mut setup = VDN.preset("fast").unwrap();
        setup.environment.instances = 1;
        let mut config: Config = setup.own().unwrap();
        config.replay.batch = batch;
        config.replay.steps_per_update = 1;
        config.optimiser.target_rate = 1.0;
        config.update.target_every = 3;
        change(&mut config);
        let opening = Opening { setup: &setup, environment: ring, seed: 1, threads: 1 };
        ValueFactorisation::new(config, &opening)
    }

    fn transition<'a>(
        (environment, state, next): (&'a dyn Environment, &'a [u8], &'a [u8]),
        actions: &'a [u16],
        step: Step,
    ) -> Transition<'a> {
        Transition {
            environment,
            instance: 0,
            state,
            actions,
            step,
            task_rewards: &[],
            agent_rewards: &[],
            next,
        }
    }

    /// One that has seen the first state of an episode so many times, each time left in one way.
    fn seen(ring: &mut dyn Environment, batch: usize, step: Step) -> ValueFactorisation {
        let mut method = new(ring, batch, |_| ());
        see(&mut method, ring, step);
        method
    }

    fn see(method: &mut ValueFactorisation, ring: &mut dyn Environment, step: Step) {
        let mut state = Vec::new();
        ring.reset(0, &mut generator(1, Purpose::Rollout, 0));
        ring.save(0, &mut state);
        for _ in 0..20 {
            method.remember(&transition((ring, &state, &state), &[1; 4], step)).unwrap();
        }
    }

    /// Plays so many steps of an episode, which is over then.
    fn play(method: &mut ValueFactorisation, ring: &mut dyn Environment, seed: u64, steps: usize) {
        let mut random = generator(seed, Purpose::Rollout, 0);
        ring.reset(0, &mut random);
        let [mut state, mut next] = [Vec::new(), Vec::new()];
        ring.save(0, &mut state);
        for number in 1..=steps {
            ring.step(0, &[1; 4], &mut random).unwrap();
            next.clear();
            ring.save(0, &mut next);
            let (reward, terminated) = (number as f64, number == steps);
            let step = Step { reward, terminated, ..Step::default() };
            method.remember(&transition((ring, &state, &next), &[1; 4], step)).unwrap();
            std::mem::swap(&mut state, &mut next);
        }
    }

    /// What an update finds that changes nothing.
    fn found(method: &mut ValueFactorisation, ring: &dyn Environment) -> UpdateReport {
        method.learn(ring, 0.0)
    }

    #[test]
    fn the_target_network_is_copied_every_so_many_updates() {
        let mut ring = ring();
        let step = Step { reward: 2.0, terminated: true, ..Step::default() };
        let mut method = seen(&mut *ring, 8, step);
        let first = method.learner.target.clone();
        // The first update is due behind the twelfth step.
        for (env_steps, copied) in [(13, false), (14, false), (15, true), (16, false)] {
            let now = Now { env_steps, of: 100 };
            let mut reports = Reports::default();
            reports.agents.extend(method.update(&*ring, now).unwrap().agents);
            assert_eq!(reports.agents.len(), 1, "{env_steps}");
            let Learner { online, target, .. } = &method.learner;
            assert_eq!(*target == online.values, copied, "{env_steps}");
            assert_eq!(*target == first, env_steps < 15, "{env_steps}");
        }
    }

    /// In a city, which looks the same from eight sides, after a walk of random actions.
    #[test]
    fn what_is_drawn_is_shown_by_any_symmetry_with_the_actions_that_it_has_there() {
        let name = "save-the-city/2-5a_2-5b";
        let mut city = sortie_envs::open(name, Split::Train, 1, &Default::default()).unwrap();
        let mut method = new(&*city, 32, |_| ());
        let mut random = generator(1, Purpose::Rollout, 0);
        let mut seen = Observation::default();
        let [mut state, mut next] = [Vec::new(), Vec::new()];
        city.reset(0, &mut random);
        city.save(0, &mut state);
        for _ in 0..40 {
            city.observe(&state, 0, EntitySet::MAX, &mut seen);
            let any = |open: &u128| member(&mut random, *open).unwrap_or(0) as u16;
            let actions: Vec<u16> = seen.available.iter().map(any).collect();
            let step = city.step(0, &actions, &mut random).unwrap();
            next.clear();
            city.save(0, &mut next);
            method.remember(&transition((&*city, &state, &next), &actions, step)).unwrap();
            std::mem::swap(&mut state, &mut next);
        }
        let turns = city.spec().turns;
        method.draw(city.spec());
        let drawn: BTreeSet<usize> = method.drawn.iter().map(|drawn| drawn.turn).collect();
        assert!(drawn.len() > turns / 2 && drawn.iter().all(|turn| *turn < turns), "{drawn:?}");
        let gathering =
            Gathering { config: &method.config, replay: &method.replay, environment: &*city };
        let shown = |drawn: Drawn| {
            let mut lesson = Lesson::default();
            gathering.fill(&mut lesson, &[drawn]);
            for (action, open) in lesson.actions.iter().zip(lesson.before.available()) {
                assert!(open >> action & 1 == 1, "{drawn:?}");
            }
            [lesson.before, lesson.after].map(|batch| {
                let rows = batch.seen().rows;
                (0..rows.len()).map(|row| rows.row(row).collect()).collect::<Vec<Vec<_>>>()
            })
        };
        let mut differ = 0;
        for drawn in &method.drawn {
            let [before, after] = shown(*drawn);
            let plain = shown(Drawn { turn: 0, ..*drawn });
            differ += usize::from(before != plain[0]);
            assert_eq!(before != plain[0], after != plain[1], "both or none: {drawn:?}");
        }
        assert!(differ > 16, "{differ}");
        method.config.replay.symmetries = false;
        method.draw(city.spec());
        assert!(method.drawn.iter().all(|drawn| drawn.turn == 0));
    }

    #[test]
    fn what_follows_an_end_is_worth_nothing_and_what_follows_a_time_out_something() {
        let end = |terminated, timed_out| {
            let step = Step { reward: 2.0, terminated, timed_out, ..Step::default() };
            let mut method = seen(&mut *ring(), 32, step);
            let place = method.replay.draw(1, &mut method.random);
            let future = method.replay.future(place, 1, 0.5);
            (future.reward, future.discount)
        };
        assert_eq!(end(true, false), (2.0, 0.0));
        assert_eq!(end(false, true), (2.0, 0.5));
        assert_eq!(end(false, false), (2.0, 0.5));
    }

    #[test]
    fn rewards_are_scaled_in_steps_and_in_episodes() {
        for (unit, rewards) in [(Unit::Steps, vec![30.0]), (Unit::Episodes, vec![30.0, 20.0, 0.0])]
        {
            let mut ring = ring();
            let mut method = new(&*ring, 1, |_| ());
            let Config { returns, replay, .. } = &mut method.config;
            (returns.steps, returns.discount, returns.scale) = (2, 1.0, 10.0);
            replay.unit = unit;
            play(&mut method, &mut *ring, 1, 2);
            let gathering =
                Gathering { config: &method.config, replay: &method.replay, environment: &*ring };
            let first = method.replay.draw(2, &mut method.random);
            let mut lesson = Lesson::default();
            let episode = Episode { first, steps: 2 };
            gathering.fill(&mut lesson, &[Drawn { episode, part: 0, turn: 0 }]);
            assert_eq!(lesson.rewards, rewards);
        }
    }

    #[test]
    fn the_gradient_is_the_mean_of_all_chunks() {
        let norm = |batch| {
            let mut ring = ring();
            let step = Step { reward: 2.0, terminated: true, ..Step::default() };
            let mut method = seen(&mut *ring, batch, step);
            found(&mut method, &*ring)
        };
        let (one, three) = (norm(32), norm(96));
        assert!(one.gradient_norm > 0.1, "{one:?}");
        assert!((one.gradient_norm - three.gradient_norm).abs() < 1e-4, "{one:?} {three:?}");
        assert!((one.loss - three.loss).abs() < 1e-6, "{one:?} {three:?}");
    }
    #[test]
    fn episodes_of_one_step_teach_what_their_steps_teach() {
        let ended = Step { reward: 2.0, terminated: true, ..Step::default() };
        let [steps, episodes]: [fn(&mut Config); 2] =
            [|_| (), |config| config.replay.unit = Unit::Episodes];
        let [one, other] = [steps, episodes].map(|change| {
            let mut ring = ring();
            let mut method = new(&*ring, 8, change);
            see(&mut method, &mut *ring, ended);
            found(&mut method, &*ring)
        });
        assert!(one.gradient_norm > 0.1, "{one:?}");
        assert!((one.gradient_norm - other.gradient_norm).abs() < 1e-4, "{one:?} {other:?}");
        assert!((one.loss - other.loss).abs() < 1e-5, "{one:?} {other:?}");
    }

    /// Whose agents remember, each its own.
    #[test]
    fn episodes_that_are_learned_from_together_do_not_meet() {
        let loss = |episodes: &[(u64, usize)]| {
            let mut ring = ring();
            let mut method = new(&*ring, episodes.len(), |config| {
                (config.replay.unit, config.network.memory) = (Unit::Episodes, 8);
            });
            for (seed, steps) in episodes {
                play(&mut method, &mut *ring, *seed, *steps);
            }
            found(&mut method, &*ring).loss
        };
        let (one, other, both) = (loss(&[(1, 2)]), loss(&[(2, 5)]), loss(&[(1, 2), (2, 5)]));
        let mean = (2.0 * one + 5.0 * other) / 7.0;
        assert!((both - mean).abs() < 1e-5, "{one} {other} {both}");
    }
}
