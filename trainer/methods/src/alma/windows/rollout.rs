//! Acting while learning: rounds of whole episodes, one in each of several environments.

use sortie_envs::random::{chance, member};
use sortie_envs::{DecisionPoints, EntitySet, Observation, Shape, UNASSIGNED};
use sortie_learn::networks::best;
use sortie_learn::subtasks::{Allocate, AllocatedScene};
use sortie_learn::{LearnError, Scenes, Transition};
use sortie_nn::random::Generator;

use super::config::Config;
use super::config::Exploration;
use super::sampling::{Episode, Moment};
use crate::alma::agents::NO_ACTION;
use crate::alma::coach::Advice;
use crate::alma::teams::{Agents, Players};

/// What one environment remembers between steps.
#[derive(Clone, Debug)]
struct Instance {
    points: DecisionPoints,
    decision: bool,
    allocation: Vec<u8>,
    last_actions: Vec<u8>,
    /// What a coach has told the agents, `[A, R]`; empty without one.
    strategies: Vec<f32>,
    /// What there is to see in the state in which its agents act.
    seen: Observation,
    episode: Episode,
}

/// The environments of a run and the buffers to act in them.
#[derive(Debug)]
pub struct Rollout {
    instances: Vec<Instance>,
    players: Players,
}

/// Who acts and allocates in a round, and how much is tried out.
pub struct Behaviour<'a> {
    /// What the agents act by.
    pub agents: Agents<'a>,
    /// Who allocates them, if anybody does.
    pub allocator: Option<&'a mut dyn Allocate>,
    /// How much is tried out.
    pub exploration: Exploration,
    /// Environment steps of the run when the round began.
    pub added: u64,
}

impl Rollout {
    /// Environments with so many agents at most, in which no episode runs yet.
    pub fn new(config: &Config, agents: usize) -> Self {
        let instance = Instance {
            points: DecisionPoints::every(config.allocation.interval),
            decision: false,
            allocation: vec![UNASSIGNED; agents],
            last_actions: vec![NO_ACTION; agents],
            strategies: Vec::new(),
            seen: Observation::default(),
            episode: Episode::default(),
        };
        Self {
            instances: vec![instance; config.environment.instances],
            players: Players::new(config.low_level.conditioning),
        }
    }

    /// Allocates and advises where that is due, and writes the actions `[scenes, A]` of all agents. Returns the number of
    /// decisions.
    ///
    /// `random` draws allocations, advice and exploration of each instance.
    ///
    /// # Errors
    /// Agents or allocator do not fit the environment.
    pub fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Generator],
        mut behaviour: Behaviour<'_>,
        actions: &mut [u16],
    ) -> Result<u64, LearnError> {
        let mut advice = behaviour.agents.coach.map(Advice::new);
        let mut decided = 0;
        for scene in scenes.scenes {
            let (instance, generator) =
                (&mut self.instances[scene.instance], &mut random[scene.instance]);
            let (environment, state) = (scenes.environment, scene.state);
            environment.observe(state, 0, EntitySet::MAX, &mut instance.seen);
            if scene.begins {
                instance.begin(environment.spec().shape, behaviour.added);
            }
            if behaviour.allocator.is_none() && advice.is_none() {
                continue;
            }
            instance.decision = instance.points.is_due(scene.tasks_changed);
            if !instance.decision {
                continue;
            }
            decided += 1;
            let Instance { seen, allocation, strategies, .. } = instance;
            if let Some(allocator) = &mut behaviour.allocator {
                allocator.allocate(environment, state, generator, allocation)?;
            }
            if let Some(advice) = &mut advice {
                advice.draw(seen, generator, strategies);
            }
        }
        self.choose(scenes, random, &behaviour, actions)?;
        Ok(decided)
    }

    /// Writes the actions of all agents: the best by their utilities, or a random one.
    fn choose(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Generator],
        behaviour: &Behaviour<'_>,
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let Self { instances, players } = self;
        let environment = scenes.environment;
        let shown = scenes.scenes.iter().map(|scene| {
            let Instance { allocation, last_actions, strategies, seen, .. } =
                &instances[scene.instance];
            let (world, state) = (scene.instance, scene.state);
            AllocatedScene { world, environment, state, seen, allocation, last_actions, strategies }
        });
        let shown: Vec<AllocatedScene<'_>> = shown.collect();
        let slots = environment.spec().shape.agents;
        let epsilon = behaviour.exploration.actions;
        actions.fill(0);
        players.act(behaviour.agents, &shown, slots, |place, agent, utilities| {
            let available = shown[place].seen.available[agent];
            let generator = &mut random[shown[place].world];
            let action = if chance(generator, epsilon.into()) {
                member(generator, available.into()).unwrap_or(0)
            } else {
                best(utilities, available)
            };
            actions[place * slots + agent] = action as u16;
        })
    }

    /// Writes down a step.
    pub fn remember(&mut self, transition: &Transition<'_>) {
        let Transition { state, actions, step, next, .. } = *transition;
        let Instance { allocation, decision, last_actions, episode, .. } =
            &mut self.instances[transition.instance];
        let moment = Moment { state, allocation, decision: *decision, actions };
        episode.push_state(moment);
        episode.push_rewards(step.reward, transition.task_rewards);
        for (last, action) in last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        if step.done() {
            episode.end(Moment { state: next, decision: false, ..moment }, step.terminated);
        }
    }

    /// The episodes of the round that is over, in the order of the instances.
    pub fn take_episodes(&mut self) -> impl Iterator<Item = Episode> {
        self.instances.iter_mut().map(|instance| std::mem::take(&mut instance.episode))
    }
}

impl Instance {
    /// An episode begins, in an environment of this shape.
    fn begin(&mut self, shape: Shape, added: u64) {
        self.points.restart();
        self.decision = false;
        self.allocation.fill(UNASSIGNED);
        self.last_actions.fill(NO_ACTION);
        self.strategies.clear();
        self.episode = Episode::begin(shape.agents, shape.tasks, added);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ops::Range;

    use crate::alma::agents::{Conditioning, TaskOrder, UtilityShape};
    use crate::alma::windows::low_level::agent_utilities;
    use crate::alma::windows::{SampleShape, Shaping, WindowLearner, WindowShape, cut_windows};
    use sortie_envs::{EntitySet, Environment, Observation, Split, Step};
    use sortie_learn::Now;
    use sortie_learn::play::Play;
    use sortie_learn::random::{Purpose, generator};
    use sortie_learn::run::EpisodeCounts;
    use sortie_learn::session::EnvironmentChoice;

    const CITY: &str = "save-the-city/2-5a_2-5b";

    /// Small networks, and agents that act at random half of the time.
    fn config(by: &str, instances: usize, episode_limit: i64) -> Config {
        let mut config = Config::default();
        config.allocation.by = by.to_owned();
        config.environment.name = CITY.to_owned();
        config.environment.instances = instances;
        config.environment.settings.insert("episode_limit".into(), episode_limit.into());
        (config.low_level.width, config.low_level.base) = (8, 8);
        (config.exploration.actions.start, config.exploration.actions.end) = (0.5, 0.5);
        config
    }

    /// Where a run learns.
    fn city(config: &Config) -> Box<dyn Environment> {
        let EnvironmentChoice { name, settings, .. } = &config.environment;
        sortie_envs::open(name, Split::Train, 1, settings).unwrap()
    }

    /// What there is to see in a state of an episode.
    fn seen(environment: &dyn Environment, episode: &Episode, state: usize) -> Observation {
        let mut seen = Observation::new(&environment.spec().shape);
        environment.observe(episode.state(state), 0, EntitySet::MAX, &mut seen);
        seen
    }

    /// Plays a round and keeps its episodes.
    fn play(config: &Config, counts: &mut EpisodeCounts) -> WindowLearner {
        let city = city(config);
        let mut method = WindowLearner::new(config, city.spec(), 5, 1);
        let stream = |index| generator(5, Purpose::Rollout, index as u64);
        let random = (0..config.environment.instances).map(stream).collect();
        let mut play = Play::new(&*city, &mut method, random);
        play.round(&mut method, Now { env_steps: 7, of: 100 }, counts).unwrap();
        method.keep_episodes();
        method
    }

    #[test]
    fn a_round_plays_whole_episodes_and_decides_by_the_rules() {
        let mut counts = EpisodeCounts::default();
        let config = config("heuristic", 3, 30);
        let (method, city) = (play(&config, &mut counts), city(&config));
        let episodes = method.replay.episodes();
        assert_eq!((episodes.len(), counts.episodes), (3, 3));
        for episode in episodes {
            assert_eq!((episode.states(), episode.added), (episode.steps() + 1, 7));
            assert!(episode.terminated || episode.steps() == 30);
            let mut since = 0;
            for state in 0..episode.steps() {
                let open = |state: usize| seen(&*city, episode, state).open_tasks;
                let changed = state > 0 && open(state) != open(state - 1);
                let due = state == 0 || since >= 5 || changed;
                assert_eq!(episode.decision(state), due, "state {state}");
                since = if due { 1 } else { since + 1 };
            }
            assert!(!episode.decision(episode.steps()), "the final state decides nothing");
        }
    }

    #[test]
    fn an_episode_keeps_its_states_in_order_and_the_last_behind_its_end() {
        let config = config("heuristic", 2, 30);
        let city = city(&config);
        let shape = city.spec().shape;
        let mut rollout = WindowLearner::new(&config, city.spec(), 1, 1).rollout;
        let instance = &mut rollout.instances[1];
        instance.begin(shape, 9);
        instance.allocation.fill(3);
        for (state, timed_out) in [(10, false), (11, false), (12, true)] {
            let step = Step { reward: f64::from(state), timed_out, ..Step::default() };
            rollout.remember(&Transition {
                environment: &*city,
                instance: 1,
                state: &[state],
                actions: &[u16::from(state); 5],
                step,
                task_rewards: &[1.0; 6],
                agent_rewards: &[],
                next: &[state + 1],
            });
        }
        let [empty, episode] = &rollout.take_episodes().collect::<Vec<_>>()[..] else { panic!() };
        assert_eq!((empty, episode.steps(), episode.added), (&Episode::default(), 3, 9));
        let states: Vec<u8> = (0..episode.states()).map(|state| episode.state(state)[0]).collect();
        assert_eq!((&states[..], episode.terminated), (&[10, 11, 12, 13][..], false));
        for step in 0..3 {
            let action = 10 + step as u8;
            assert_eq!(
                (episode.actions(step), episode.allocation(step)),
                (&[action; 5][..], &[3; 5][..])
            );
            assert_eq!(
                (episode.reward(step), episode.task_reward(step)),
                (f32::from(action), &[1.0; 6][..])
            );
        }
    }

    /// In a battle heads point, and know of pairs what rows do not show.
    #[test]
    fn agents_see_in_windows_what_they_saw_when_they_acted() {
        const BATTLE: &str = "skirmish/6-8sz-symmetric";
        for (name, conditioning, recurrent) in [
            (CITY, Conditioning::Mask, false),
            (CITY, Conditioning::Input, false),
            (CITY, Conditioning::None, false),
            (CITY, Conditioning::Mask, true),
            (BATTLE, Conditioning::Mask, false),
            (BATTLE, Conditioning::Input, true),
        ] {
            let mut config = config("random", 2, 20);
            if name == BATTLE {
                config.environment.settings.clear();
                config.allocation.by = "matching".to_owned();
            }
            config.environment.name = name.to_owned();
            config.low_level.recurrent = recurrent;
            config.low_level.conditioning = conditioning;
            let WindowLearner { low_level: mut level, replay, .. } =
                play(&config, &mut EpisodeCounts::default());
            // Were pairs told in rows, embeddings would differ now.
            let UtilityShape { width, targets, .. } = level.shape();
            let Range { start, end } = targets.pairs();
            level.online.values[start * width..end * width].fill(0.3);
            let mut weights = generator(1, Purpose::Weights, 0);

            let shaping = Shaping::default();
            let sample = SampleShape { windows: 2, steps: 160, shaping };
            let city = city(&config);
            let windows = cut_windows(&*city, &replay, &[0, 1], sample, &mut weights);
            let (order, slots) = (TaskOrder::identity(6), windows.shape.agents);
            assert_eq!(targets.count > 0, name == BATTLE);
            let in_windows = agent_utilities(level.players(), &windows, conditioning, &order);
            let mut players = Players::new(conditioning);
            let mut compared = 0;
            for (world, episode) in replay.episodes().iter().enumerate() {
                let mut last_actions = vec![NO_ACTION; slots];
                for state in 0..episode.steps() {
                    let act = |_: usize, agent: usize, utilities: &[f32]| {
                        let WindowShape { steps, actions, .. } = windows.shape;
                        let at = ((world * steps + state) * slots + agent) * actions;
                        for (acted, learned) in utilities.iter().zip(&in_windows[at..]) {
                            assert!((acted - learned).abs() < 1e-5, "{acted} {learned}");
                        }
                        compared += 1;
                    };
                    let scene = AllocatedScene {
                        world,
                        environment: &*city,
                        state: episode.state(state),
                        seen: &seen(&*city, episode, state),
                        allocation: episode.allocation(state),
                        last_actions: &last_actions,
                        strategies: &[],
                    };
                    players.act(level.players(), &[scene], slots, act).unwrap();
                    last_actions.copy_from_slice(episode.actions(state));
                }
            }
            assert!(compared > 50, "{compared}");
        }
    }
}
