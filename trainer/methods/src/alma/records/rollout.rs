//! Acting while learning: episodes in many instances, explored, cut into records.

use serde::{Deserialize, Serialize};
use sortie_envs::random::chance;
use sortie_envs::{EntitySet, Observation, Spec};
use sortie_learn::{LearnError, Scenes, Transition};
use sortie_nn::random::Generator;

use super::config::Config;
use super::deciding::{Deciding, Decisions};
use super::history::{History, Reached, StepRewards};
use super::replay::Replay;
use super::team_value::Segments;
use crate::alma::agents::{
    Columns, NO_ACTION, TeamBatch, UtilityNetwork, UtilityPass, best_action, random_action,
};

/// What an instance remembers between steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Instance {
    decisions: Decisions,
    last_actions: Vec<u8>,
    history: History,
    /// The number of the moment in which its agents act.
    #[serde(skip)]
    number: u64,
    /// What there is to see in it.
    #[serde(skip)]
    seen: Observation,
}

/// Who acts and allocates in a step.
#[derive(Clone, Copy, Debug)]
pub struct Behaviour<'a> {
    /// The agents' utility network.
    pub agents: &'a UtilityNetwork,
    /// How often agents act at random, before the instances' factors.
    pub epsilon: f32,
    /// The team-value network; without one, rules decide in its stead.
    pub allocator: Option<&'a UtilityNetwork>,
}

/// What keeps the experience of a step.
#[derive(Debug)]
pub struct Memory<'a> {
    /// Records of the agents.
    pub records: &'a mut Replay,
    /// Segments of the allocator, if it learns.
    pub segments: Option<&'a mut Segments>,
}

/// The instances of a run and the buffers to act in them.
#[derive(Debug)]
pub struct Rollout {
    instances: Vec<Instance>,
    deciding: Deciding,
    spread: Vec<f32>,
    batch: TeamBatch,
    pass: UtilityPass,
    /// (scene, agent) of every row of the batch.
    actors: Vec<(usize, usize)>,
}

impl Rollout {
    /// Instances of an environment, none of which has begun an episode.
    pub fn new(config: &Config, spec: &Spec) -> Self {
        let agents = spec.shape.agents;
        let instance = Instance {
            decisions: Decisions::new(config.allocation.interval, agents),
            last_actions: vec![NO_ACTION; agents],
            history: History::new(config.network.subtask, (&config.returns).into()),
            number: 0,
            seen: Observation::default(),
        };
        Self {
            instances: vec![instance; config.environment.instances],
            deciding: Deciding::new(config, spec),
            spread: config.exploration.spread.clone(),
            batch: TeamBatch::new(config.network.subtask),
            pass: UtilityPass::new(config.network.shape(spec)),
            actors: Vec::new(),
        }
    }

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations() + self.deciding.operations()
    }

    /// An instance is about to start an episode.
    pub fn begin(&mut self, instance: usize, generator: &mut Generator) {
        let instance = &mut self.instances[instance];
        instance.decisions.restart(&self.deciding, generator);
        instance.last_actions.fill(NO_ACTION);
    }

    /// Decides where that is due and writes the actions `[scenes, A]` of all agents; stores the records and segments that
    /// a decision completes. Returns the number of decisions.
    ///
    /// `random` draws allocations and exploration of each instance.
    ///
    /// # Errors
    /// The allocator does not fit the environment.
    pub fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Generator],
        behaviour: Behaviour<'_>,
        mut memory: Memory<'_>,
        actions: &mut [u16],
    ) -> Result<u64, LearnError> {
        let mut decided = 0;
        let environment = scenes.environment;
        for scene in scenes.scenes {
            let instance = &mut self.instances[scene.instance];
            let Instance { decisions, history, last_actions, number, seen } = instance;
            environment.observe(scene.state, 0, EntitySet::MAX, seen);
            *number = memory.records.moments.push(scene.state, last_actions);
            let now = Reached { environment, state: scene.state, number: *number };
            let segments = memory.segments.as_deref_mut();
            let (generator, network) = (&mut random[scene.instance], behaviour.allocator);
            let due = self.deciding.decide(decisions, (now, seen), generator, network, segments)?;
            decided += u64::from(due);
            history.decide(now, &decisions.allocation, memory.records);
            history.begin(now, seen, &decisions.allocation, memory.records);
        }
        self.choose(scenes, random, behaviour, actions);
        Ok(decided)
    }

    /// Writes the actions of all agents: the best by the network, or a random one.
    fn choose(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Generator],
        behaviour: Behaviour<'_>,
        actions: &mut [u16],
    ) {
        let Self { instances, batch, pass, actors, spread, .. } = self;
        let shape = scenes.environment.spec().shape;
        batch.clear(Columns::of(&shape));
        actors.clear();
        // An agent without a subtask does nothing.
        actions.fill(scenes.environment.spec().safe_action.unwrap_or(0));
        for (place, scene) in scenes.scenes.iter().enumerate() {
            let Instance { decisions, last_actions, seen, .. } = &instances[scene.instance];
            batch.push_teams(seen, &decisions.allocation, last_actions, |agent| {
                actors.push((place, agent));
            });
        }
        let utilities = pass.forward(behaviour.agents, batch.finish());
        for ((place, agent), utilities) in actors.iter().zip(utilities.chunks_exact(shape.actions))
        {
            let index = scenes.scenes[*place].instance;
            let available = instances[index].seen.available[*agent];
            let explore = behaviour.epsilon * spread[index % spread.len()];
            let generator = &mut random[index];
            let action = if chance(generator, explore.into()) {
                random_action(available, generator)
            } else {
                best_action(utilities, available)
            };
            actions[place * shape.agents + agent] = action.into();
        }
    }

    /// Stores the records and segments that a step completes.
    pub fn remember(&mut self, transition: &Transition<'_>, memory: Memory<'_>) {
        let Memory { records, segments } = memory;
        let Transition { environment, actions, step, task_rewards, next, .. } = *transition;
        let Instance { history, decisions, last_actions, number, seen } =
            &mut self.instances[transition.instance];
        records.moments.act(*number, &actions[..seen.agents()]);
        for (last, action) in last_actions.iter_mut().zip(actions) {
            *last = *action as u8;
        }
        environment.observe(next, 0, 0, seen);
        let rewards = StepRewards { tasks: task_rewards, team: step.reward };
        history.reward(seen.open_tasks, rewards, records);
        if step.done() {
            let timed_out = step.timed_out.then(|| Reached {
                environment,
                state: next,
                number: records.moments.push(next, last_actions),
            });
            history.end(timed_out, records);
        }
        decisions.reward(self.deciding.discount(), task_rewards, step.tasks_changed);
        if step.done() {
            decisions.end(step.timed_out, segments);
        }
    }

    /// Names what the instances remember.
    ///
    /// # Errors
    /// What is read does not fit.
    pub fn state(&mut self, state: &mut sortie_learn::State<'_>) -> Result<(), LearnError> {
        let before = sizes(&self.instances);
        state.value("instances", &mut self.instances)?;
        if sizes(&self.instances) != before {
            return Err(LearnError::Config("the checkpoint has other instances".to_owned()));
        }
        Ok(())
    }
}

/// How many agents each instance remembers things of.
fn sizes(instances: &[Instance]) -> Vec<[usize; 2]> {
    let size =
        |instance: &Instance| [instance.decisions.allocation.len(), instance.last_actions.len()];
    instances.iter().map(size).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::agents::UtilityShape;
    use crate::alma::records::team_value::Decision;
    use crate::alma::records::toy::{Fixed, begin, fixed, observer, play, usual};
    use sortie_envs::Split;

    fn config(episode_limit: i64) -> Config {
        let mut config = usual();
        config.environment.settings.insert("episode_limit".into(), episode_limit.into());
        config.environment.instances = 3;
        config.allocator.network.width = 8;
        config
    }

    #[test]
    fn segments_join_decisions_of_one_episode() {
        let config = config(200);
        let mut method = Fixed { decides_from: 300, ..fixed(&config, 10_000) };
        let decisions = play(&mut begin(&config, 1, &mut method), &mut method, 600).1;
        let segments = method.segments.unwrap();
        assert!(segments.len() > 300 && segments.len() as u64 <= decisions);
        assert!(segments.fits(10_000));
        let (mut ends, mut full) = (0, 0);
        let environment = observer(&config);
        let seen = |decision: &Decision| {
            let mut seen = Observation::default();
            environment.observe(&decision.state, 0, EntitySet::MAX, &mut seen);
            seen
        };
        for segment in (0..segments.len()).map(|index| segments.get(index)) {
            let (now, next) = (seen(&segment.now), seen(&segment.next));
            // The first feature of an agent that is not zero is its kind.
            let kinds = |seen: &Observation| {
                let kind = |agent| seen.rows.row(agent).next().map(|(column, _)| column);
                (0..seen.agents()).map(kind).collect::<Vec<_>>()
            };
            assert_eq!(kinds(&now), kinds(&next));
            for task in &segment.now.allocation {
                assert!(now.open_tasks >> task & 1 == 1);
            }
            ends += usize::from(segment.discount == 0.0);
            full += usize::from((segment.discount - 0.99_f32.powi(5)).abs() < 1e-6);
        }
        assert!(ends > 0 && full > 100, "{ends} ends, {full} full segments");
    }

    #[test]
    fn a_segment_that_runs_out_of_time_is_dropped() {
        let config = config(5);
        let mut method = Fixed { decides_from: 9, ..fixed(&config, 100) };
        let mut instances = begin(&config, 1, &mut method);
        let kept = |method: &Fixed| method.segments.as_ref().unwrap().len() as u64;
        play(&mut instances, &mut method, 4);
        let before = kept(&method);
        let decisions = play(&mut instances, &mut method, 1).1;
        assert_eq!(kept(&method), before + decisions, "only decisions end segments");
        assert_eq!(play(&mut instances, &mut method, 1).1, 3);
        assert_eq!(kept(&method), before + decisions, "a new episode joins nothing");
    }

    #[test]
    fn records_reach_to_the_state_in_which_time_ran_out() {
        let config = config(5);
        let mut method = Fixed { epsilon: 1.0, decides_from: 99, ..fixed(&config, 1) };
        play(&mut begin(&config, 1, &mut method), &mut method, 40);
        let mut environment = observer(&config).open(1, Split::Test);
        let mut steps = |state: &[u8]| {
            environment.load(0, state).unwrap();
            environment.episode(0).steps
        };
        let mut last = [0; 2];
        for index in 0..method.records.len() {
            let sample = method.records.get(index);
            let [now, next] = [sample.now, sample.next].map(|moment| steps(moment.state));
            if sample.record.discount > 0.0 {
                assert!((1..=3).contains(&(next - now)), "from step {now} to step {next}");
                let ended = next == 5;
                if next == now + 1 {
                    let taken = sample.now.actions.iter().filter(|action| **action != NO_ACTION);
                    assert!(sample.next.last_actions.iter().zip(taken).all(|(last, a)| last == a));
                }
                assert_eq!(sample.next.actions[0] == NO_ACTION, ended, "nobody acts any more");
                last[usize::from(ended)] += 1;
            } else {
                assert_eq!(now, next);
            }
        }
        assert!(last[0] > 50 && last[1] > 50, "{last:?}");
    }

    #[test]
    fn instances_of_a_checkpoint_go_on_and_others_are_refused() {
        let config = config(200);
        let mut method = fixed(&config, 100);
        play(&mut begin(&config, 1, &mut method), &mut method, 7);
        let Rollout { instances, .. } = &method.rollout;
        let written = serde_json::to_string(instances).unwrap();
        let read: Vec<Instance> = serde_json::from_str(&written).unwrap();
        let blank = |instance: &Instance| Instance {
            number: 0,
            seen: Observation::default(),
            ..instance.clone()
        };
        assert_eq!(read, instances.iter().map(blank).collect::<Vec<_>>());
        let mut spec = observer(&config).spec().clone();
        let five = sizes(&Rollout::new(&config, &spec).instances);
        spec.shape.agents = 4;
        assert_ne!(sizes(&Rollout::new(&config, &spec).instances), five);
    }

    /// Agents that like an action the more the higher its number is.
    fn fond_of_high_numbers(shape: UtilityShape) -> UtilityNetwork {
        let mut parameters = vec![0.0; shape.parameters()];
        let biases = shape.tensors().into_iter().find(|tensor| tensor.name == "head.bias");
        let biases = &mut parameters[biases.unwrap().range];
        biases.iter_mut().enumerate().for_each(|(action, bias)| *bias = action as f32);
        UtilityNetwork::from_parameters(shape, parameters).unwrap()
    }

    #[test]
    fn agents_explore_as_often_as_their_instance_and_evenly() {
        let mut config = config(200);
        config.exploration.spread = vec![0.0, 0.5, 1.0];
        let agents = fond_of_high_numbers(config.network.shape(observer(&config).spec()));
        let mut method = Fixed {
            agents,
            epsilon: 1.0,
            decides_from: u64::MAX,
            segments: None,
            ..fixed(&config, 1)
        };
        let mut instances = begin(&config, 1, &mut method);
        // Of agents in the open, with five available actions: how often each of these was taken.
        let mut taken = [[0.0; 5]; 3];
        for _ in 0..1500 {
            play(&mut instances, &mut method, 1);
            for (instance, available, action) in method.acted.drain(..) {
                assert_eq!(available >> action & 1, 1, "only available actions are taken");
                if available.count_ones() == 5 {
                    taken[instance][(available & ((1 << action) - 1)).count_ones() as usize] += 1.0;
                }
            }
        }
        for (taken, epsilon) in taken.iter().zip([0.0, 0.5, 1.0]) {
            let total: f64 = taken.iter().sum();
            assert!(total > 1000.0, "{taken:?}");
            for (place, count) in taken.iter().enumerate() {
                let greedy = f64::from(u8::from(place == 4));
                let share = epsilon / 5.0 + (1.0 - epsilon) * greedy;
                assert!((count / total - share).abs() < 0.04, "{epsilon}: {taken:?}");
            }
        }
    }
}
