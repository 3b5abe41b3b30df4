//! Value factorisation as a [`Method`].

use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, UpdateReport};
use sortie_learn::session::Opening;
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};

use super::acting::Acting;
use super::config::Config;
use super::deployed::deployed;
use super::learner::Learner;
use super::replay::{End, Replay};
use super::temporal_difference::Network;
use super::tensors::Tensor;

/// Agents that learn from the team's reward, and what they have seen.
#[derive(Debug)]
pub struct ValueFactorisation {
    config: Config,
    learner: Learner,
    replay: Replay,
    /// Draws records and partitions.
    random: Random,
    acting: Acting,
    updates: u64,
    /// Environment steps before the first update.
    first: u64,
}

impl ValueFactorisation {
    /// Draws the first weights.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, spec, seed, threads } = *opening;
        let instances = setup.environment.instances;
        let mut weights = generator(seed, Purpose::Weights, 0);
        let network = Network::initialise(config.shape(spec), &mut weights);
        let capacity = config.replay.capacity / instances;
        // Every instance needs to have played for longer than a record looks ahead.
        let first = (4 * config.returns.steps * instances).max(config.replay.batch) as u64;
        Self {
            learner: Learner::new(config.clone(), network, threads),
            replay: Replay::new(instances, capacity, spec.shape.agents, spec.state_bytes),
            random: generator(seed, Purpose::Replay, 0),
            acting: Acting::default(),
            updates: 0,
            first,
            config,
        }
    }
}

impl Method for ValueFactorisation {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut Random,
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let exploration = &self.config.exploration;
        let epsilon = exploration.epsilon_at(now.env_steps);
        let factor = |instance: usize| exploration.spread[instance % exploration.spread.len()];
        let chances = scenes.scenes.iter().map(|scene| (epsilon * factor(scene.instance)).min(1.0));
        self.acting.look(scenes);
        self.acting.act(self.learner.online(), chances, random, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let Transition { instance, state, actions, step, next, .. } = *transition;
        let end = match (step.terminated, step.timed_out) {
            (true, _) => End::Over,
            (_, true) => End::TimedOut,
            _ => End::Open,
        };
        self.replay.push(instance, state, actions, step.reward as f32, end);
        if step.done() {
            self.replay.push_last(instance, next);
        }
        Ok(())
    }

    fn update(
        &mut self,
        environment: &dyn Environment,
        now: Now,
        reports: &mut Vec<UpdateReport>,
    ) -> Result<(), LearnError> {
        let due = now.env_steps.saturating_sub(self.first) / self.config.replay.steps_per_update;
        let rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        while self.updates < due {
            self.updates += 1;
            let report = self.learner.update(&self.replay, environment, rate, &mut self.random);
            reports.push(report);
        }
        Ok(())
    }

    fn rates(&self, now: Now) -> Rates {
        Rates {
            epsilon: self.config.exploration.epsilon_at(now.env_steps),
            learning_rate: self.config.optimiser.learning_rate_at(now.env_steps, now.of),
        }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy { network: self.learner.average(), acting: Acting::default() })
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let Learner { online, target, average, adam, .. } = &mut self.learner;
        let tensors: Vec<_> = online.shape.tensors().iter().map(Tensor::saved).collect();
        for (name, vector) in [
            ("online", &mut online.parameters),
            ("target", &mut target.parameters),
            ("average", &mut average.parameters),
            ("adam-mean", &mut adam.mean),
            ("adam-square", &mut adam.square),
        ] {
            state.tensors(name, &tensors, vector)?;
        }
        state.value("adam-steps", &mut adam.steps)?;
        state.value("updates", &mut self.updates)?;
        state.value("random", &mut self.random)?;
        state.value("replay", &mut self.replay)
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Ok(deployed(self.learner.average()))
    }
}

/// Agents that take the best action that they know.
struct Greedy<'a> {
    network: &'a Network,
    acting: Acting,
}

impl Act for Greedy<'_> {
    fn act(&mut self, scenes: &Scenes<'_>, actions: &mut [u16]) -> Result<(), LearnError> {
        self.acting.look(scenes);
        self.acting.choose(self.network, actions);
        Ok(())
    }
}

impl Acting {
    /// Looks at scenes in the place of those before.
    fn look(&mut self, scenes: &Scenes<'_>) {
        self.clear();
        let mut seen = Observation::default();
        for scene in scenes.scenes {
            scenes.environment.observe(scene.state, 0, EntitySet::MAX, &mut seen);
            self.push(&seen);
        }
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Split, Step};

    use super::super::keys::VDN;
    use super::*;

    fn ring() -> Box<dyn Environment> {
        sortie_envs::open("group-matching/4x3x2", Split::Train, 1, &Default::default()).unwrap()
    }

    /// A method that has seen the first state of an episode so many times, each time left in one way.
    fn seen(ring: &mut dyn Environment, batch: usize, step: Step) -> ValueFactorisation {
        let mut setup = VDN.preset("fast").unwrap();
        setup.environment.instances = 1;
        let mut config: Config = setup.own().unwrap();
        config.replay.batch = batch;
        let opening = Opening { setup: &setup, spec: ring.spec(), seed: 1, threads: 1 };
        let mut method = ValueFactorisation::new(config, &opening);
        let mut state = Vec::new();
        ring.reset(0, &mut generator(1, Purpose::Rollout, 0));
        ring.save(0, &mut state);
        for _ in 0..20 {
            let transition = Transition {
                environment: ring,
                instance: 0,
                state: &state,
                actions: &[1; 4],
                step,
                task_rewards: &[],
                agent_rewards: &[],
                next: &state,
            };
            method.remember(&transition).unwrap();
        }
        method
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
    fn the_gradient_is_the_mean_of_all_chunks() {
        let norm = |batch| {
            let mut ring = ring();
            let step = Step { reward: 2.0, terminated: true, ..Step::default() };
            let mut method = seen(&mut *ring, batch, step);
            let ValueFactorisation { learner, replay, random, .. } = &mut method;
            learner.update(replay, &*ring, 0.0, random)
        };
        let (one, three) = (norm(32), norm(96));
        assert!(one.gradient_norm > 0.1, "{one:?}");
        assert!((one.gradient_norm - three.gradient_norm).abs() < 1e-4, "{one:?} {three:?}");
        assert!((one.loss - three.loss).abs() < 1e-6, "{one:?} {three:?}");
    }
}
