//! The loop in which teams play: to learn, and to be measured.

mod episodes;
mod planner;
mod teams;

use std::collections::{BTreeMap, VecDeque};

use rand_core::Rng;
use serde::{Deserialize, Serialize};
use sortie_envs::{Environment, Random, Spec, Split, Step};

use crate::act::{Ask, Scene, Scenes};
use crate::error::{LearnError, Result};
use crate::evaluate::metric_means;
use crate::method::{Method, Transition};
use crate::run::{EpisodeCounts, Now};
use crate::state::State;

pub use episodes::{Onlooker, Start, WORLDS, Watched, evaluate, evaluate_watched, watch};
pub use planner::{Planner, PlannerReport};
pub use teams::{PolicyTeam, RandomTeam};

/// Instances that are played to learn from.
pub struct Play {
    worlds: Box<dyn Environment>,
    /// A generator for each instance: it draws what its steps, and whoever acts in it, leave to chance.
    random: Vec<Random>,
    running: Vec<Running>,
    recent: Recent,
    actions: Vec<u16>,
    next: Vec<u8>,
}

/// The running episode of an instance.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
struct Running {
    state: Vec<u8>,
    begins: bool,
    tasks_changed: bool,
    is_over: bool,
    episode_return: f64,
}

impl Play {
    /// Starts an episode for each of these generators.
    pub fn new(
        environment: &dyn Environment,
        method: &mut dyn Method,
        random: Vec<Random>,
    ) -> Self {
        let worlds = environment.open(random.len(), Split::Train);
        let running = vec![Running::default(); random.len()];
        let (recent, actions, next) = Default::default();
        let mut play = Self { worlds, random, running, recent, actions, next };
        (0..play.running.len()).for_each(|instance| play.start(instance, method));
        play
    }

    /// What is played in.
    pub fn environment(&self) -> &dyn Environment {
        &*self.worlds
    }

    /// Means of the environment's metrics over the last hundred episodes that ended, by their names; none before.
    pub fn recent(&self) -> BTreeMap<String, f64> {
        self.recent.means(self.worlds.spec())
    }

    /// Steps every instance once; where the method [waits](Method::waits) and does not learn meanwhile, until the
    /// episodes of all are over. Returns the number of steps.
    ///
    /// # Errors
    /// The method cannot act or remember, or chose an action that is not available.
    pub fn round(
        &mut self,
        method: &mut dyn Method,
        now: Now,
        counts: &mut EpisodeCounts,
    ) -> Result<u64> {
        let mut steps = 0;
        let all_are_over = loop {
            self.act(method, now)?;
            let mut place = 0;
            for instance in 0..self.running.len() {
                if !self.running[instance].is_over {
                    self.advance(instance, place, method, counts)?;
                    place += 1;
                }
            }
            steps += place as u64;
            let all_are_over = self.running.iter().all(|running| running.is_over);
            if all_are_over || !method.waits() || method.learns_while_waiting() {
                break all_are_over;
            }
        };
        for instance in 0..self.running.len() {
            if self.running[instance].is_over && (all_are_over || !method.waits()) {
                self.start(instance, method);
            }
        }
        Ok(steps)
    }

    /// Lets the method act in all instances whose episode runs.
    fn act(&mut self, method: &mut dyn Method, now: Now) -> Result<()> {
        let running = self.running.iter().enumerate().filter(|(_, running)| !running.is_over);
        let scene = |(instance, running)| {
            let Running { state, begins, tasks_changed, .. }: &Running = running;
            Scene { instance, state, begins: *begins, tasks_changed: *tasks_changed }
        };
        let scenes: Vec<Scene<'_>> = running.map(scene).collect();
        self.actions.clear();
        self.actions.resize(scenes.len() * self.worlds.spec().shape.agents, 0);
        let scenes = &Scenes { environment: &*self.worlds, scenes: &scenes };
        let Self { random, actions, .. } = self;
        method.act(Ask { scenes, random, actions }, now)
    }

    /// Steps an instance, whose actions stand at a place.
    fn advance(
        &mut self,
        instance: usize,
        place: usize,
        method: &mut dyn Method,
        counts: &mut EpisodeCounts,
    ) -> Result<()> {
        let agents = self.worlds.spec().shape.agents;
        let actions = &self.actions[place * agents..][..agents];
        let step = self.worlds.step(instance, actions, &mut self.random[instance])?;
        self.next.clear();
        self.worlds.save(instance, &mut self.next);
        let running = &mut self.running[instance];
        method.remember(&Transition {
            environment: &*self.worlds,
            instance,
            state: &running.state,
            actions,
            step,
            task_rewards: self.worlds.task_rewards(instance),
            agent_rewards: self.worlds.agent_rewards(instance),
            next: &self.next,
        })?;
        std::mem::swap(&mut running.state, &mut self.next);
        running.begins = false;
        running.tasks_changed = step.tasks_changed;
        running.is_over = step.done();
        running.episode_return += step.reward;
        if step.done() {
            self.count(instance, step, counts);
        }
        Ok(())
    }

    fn count(&mut self, instance: usize, step: Step, counts: &mut EpisodeCounts) {
        let episode = self.worlds.episode(instance);
        counts.episodes += 1;
        counts.solved += u64::from(episode.solved);
        counts.timed_out += u64::from(step.timed_out);
        counts.return_sum += self.running[instance].episode_return;
        self.recent.add(episode.metrics);
    }

    /// Starts an episode, from a generator of its own, so that starts with more draws shift nothing else.
    fn start(&mut self, instance: usize, method: &mut dyn Method) {
        let random = &mut self.random[instance];
        method.begins(instance, random);
        self.worlds.reset(instance, &mut sortie_envs::random::generator(random.next_u64()));
        let mut running = Running { begins: true, ..Running::default() };
        self.worlds.save(instance, &mut running.state);
        self.running[instance] = running;
    }

    /// Names what the rest of the play depends on.
    pub fn state(&mut self, state: &mut State<'_>) -> Result<()> {
        let instances = self.running.len();
        state.value("play/random", &mut self.random)?;
        state.value("play/running", &mut self.running)?;
        state.later("play/recent", &mut self.recent)?;
        if [self.random.len(), self.running.len()] != [instances; 2] {
            return Err(LearnError::Config("the checkpoint has other instances".to_owned()));
        }
        for (instance, running) in self.running.iter().enumerate().filter(|_| state.is_reading()) {
            let loaded = self.worlds.load(instance, &running.state);
            loaded.map_err(|error| LearnError::Config(format!("instance {instance}: {error}")))?;
        }
        Ok(())
    }
}

/// Episodes that means are taken of: as many as dissertations and papers take for curves of training.
const LAST: usize = 100;

/// The environment's metrics of the last episodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Recent {
    episodes: VecDeque<Vec<Option<f64>>>,
}

impl Recent {
    pub(super) fn add(&mut self, metrics: Vec<Option<f64>>) {
        self.episodes.truncate(LAST - 1);
        self.episodes.push_front(metrics);
    }

    /// Means of the metrics that evaluations tell, by their names; none before so many episodes ended.
    pub(super) fn means(&self, spec: &Spec) -> BTreeMap<String, f64> {
        if self.episodes.len() < LAST {
            return BTreeMap::new();
        }
        metric_means(spec, self.episodes.iter().map(Vec::as_slice))
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;

    use super::*;
    use crate::act::Act;
    use crate::run::Rates;

    /// Stays, and counts the episodes that it is told of and those that it sees begin.
    #[derive(Default)]
    struct Counting {
        waits: bool,
        learns_while_waiting: bool,
        told: Vec<usize>,
        seen: Vec<usize>,
        earned: f64,
        timed_out: u64,
    }

    impl Method for Counting {
        fn waits(&self) -> bool {
            self.waits
        }

        fn learns_while_waiting(&self) -> bool {
            self.learns_while_waiting
        }

        fn begins(&mut self, instance: usize, _: &mut Random) {
            self.told.push(instance);
        }

        fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>, _: Now) -> Result<()> {
            let begun = scenes.scenes.iter().filter(|scene| scene.begins);
            self.seen.extend(begun.map(|scene| scene.instance));
            actions.fill(1);
            Ok(())
        }

        fn remember(&mut self, transition: &Transition<'_>) -> Result<()> {
            self.earned += transition.step.reward;
            self.timed_out += u64::from(transition.step.timed_out);
            Ok(())
        }

        fn rates(&self, _: Now) -> Rates {
            Rates { epsilon: 0.0, learning_rate: 0.0 }
        }

        fn team(&self) -> Box<dyn Act + '_> {
            Box::new(RandomTeam::new(1))
        }

        fn state(&mut self, _: &mut State<'_>) -> Result<()> {
            Ok(())
        }
    }

    fn play(method: &mut Counting) -> Play {
        let ring = sortie_envs::open("group-matching/4x3x2", Split::Train, 1, &Default::default());
        Play::new(&*ring.unwrap(), method, [1, 2, 3].map(generator).to_vec())
    }

    #[test]
    fn a_method_is_told_of_every_episode_before_it_sees_it() {
        let mut method = Counting::default();
        let (mut play, mut counts) = (play(&mut method), EpisodeCounts::default());
        assert_eq!((&method.told[..], method.seen.len()), (&[0, 1, 2][..], 0));
        for _ in 0..100 {
            assert_eq!(play.round(&mut method, Now::default(), &mut counts).unwrap(), 3);
        }
        // What began in the last round is seen in the next.
        assert_eq!(method.told[..method.seen.len()], method.seen);
        assert!(counts.episodes >= 3 && method.told.len() as u64 == 3 + counts.episodes);
    }

    #[test]
    fn episodes_are_counted_with_what_they_earned() {
        let mut method = Counting { waits: true, ..Counting::default() };
        let (mut play, mut counts) = (play(&mut method), EpisodeCounts::default());
        for _ in 0..4 {
            play.round(&mut method, Now::default(), &mut counts).unwrap();
        }
        assert_eq!((counts.episodes, counts.timed_out), (12, method.timed_out));
        // An episode is solved or runs out of time here.
        assert_eq!(counts.solved + counts.timed_out, 12);
        assert!(method.earned != 0.0 && (counts.return_sum - method.earned).abs() < 1e-9);
    }

    #[test]
    fn who_waits_plays_rounds_of_one_episode_in_each_instance() {
        let mut method = Counting { waits: true, ..Counting::default() };
        let (mut play, mut counts) = (play(&mut method), EpisodeCounts::default());
        let steps = play.round(&mut method, Now::default(), &mut counts).unwrap();
        assert!(steps > 3 && steps <= 3 * 50, "{steps}");
        assert_eq!((counts.episodes, &method.seen[..]), (3, &[0, 1, 2][..]));
        assert_eq!(method.told, [0, 1, 2, 0, 1, 2]);
    }

    #[test]
    fn who_learns_while_others_wait_has_them_wait_all_the_same() {
        let mut method =
            Counting { waits: true, learns_while_waiting: true, ..Counting::default() };
        let (mut play, mut counts) = (play(&mut method), EpisodeCounts::default());
        let mut stepped = Vec::new();
        while counts.episodes < 3 {
            stepped.push(play.round(&mut method, Now::default(), &mut counts).unwrap());
        }
        assert_eq!((stepped[0], counts.episodes, &method.seen[..]), (3, 3, &[0, 1, 2][..]));
        assert!(
            stepped.is_sorted_by(|one, next| one >= next) && stepped.contains(&1),
            "{stepped:?}"
        );
        assert_eq!(method.told, [0, 1, 2, 0, 1, 2], "they start anew together");
        assert_eq!(play.round(&mut method, Now::default(), &mut counts).unwrap(), 3);
    }

    const METRICS: &[sortie_envs::Metric] = &[
        sortie_envs::Metric::recorded("hidden", "", ""),
        sortie_envs::Metric::reported("found", "", ""),
    ];

    #[test]
    fn means_are_those_of_the_last_hundred() {
        let spec = Spec { metrics: METRICS.to_vec(), ..Spec::default() };
        let mut recent = Recent::default();
        for episode in 0..LAST {
            assert!(recent.means(&spec).is_empty(), "after {episode}");
            recent.add(vec![Some(5.0), Some(episode as f64)]);
        }
        assert_eq!(recent.means(&spec), [("found".to_owned(), 49.5)].into());
        recent.add(vec![Some(5.0), Some(100.0)]);
        assert_eq!(recent.means(&spec)["found"], 50.5, "the first does not count any more");
        // Episodes that have no such number do not count.
        (0..LAST - 1).for_each(|_| recent.add(vec![None, None]));
        assert_eq!(recent.means(&spec)["found"], 100.0);
    }
}
