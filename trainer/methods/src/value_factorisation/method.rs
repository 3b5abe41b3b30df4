//! Value factorisation as a [`Method`].

use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};

use super::acting::{Acting, deployed};
use super::learner::{Experience, Learner, Update};
use super::looking::Tensor;
use super::temporal_difference::Network;
use super::{Config, Unit};

/// Agents that learn from the team's reward, and what they have seen.
#[derive(Debug)]
pub struct ValueFactorisation {
    config: Config,
    learner: Learner,
    experience: Experience,
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
        let Opening { setup, environment, seed, threads } = *opening;
        let spec = environment.spec();
        let instances = setup.environment.instances;
        let mut weights = generator(seed, Purpose::Weights, 0);
        let network = Network::initialise(config.shape(spec), &mut weights);
        // Every instance needs to have played for longer than a record looks ahead.
        let first = (4 * config.returns.steps * instances).max(config.replay.batch) as u64;
        Self {
            learner: Learner::new(config.clone(), network, threads),
            experience: Experience::new(&config.replay, instances, spec),
            random: generator(seed, Purpose::Replay, 0),
            acting: Acting::default(),
            updates: 0,
            first,
            config,
        }
    }
}

impl Method for ValueFactorisation {
    /// Who learns from whole episodes plays them in rounds, as in the public code.
    fn waits(&self) -> bool {
        self.config.replay.unit == Unit::Episodes
    }

    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let exploration = &self.config.exploration;
        let epsilon = exploration.epsilon_at(now.env_steps);
        let factor = |instance: usize| exploration.spread[instance % exploration.spread.len()];
        let chances = scenes.scenes.iter().map(|scene| (epsilon * factor(scene.instance)).min(1.0));
        let teams = chances.zip(scenes.generators(random));
        self.acting.look(scenes);
        self.acting.act(self.learner.online(), teams, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.experience.push(transition);
        Ok(())
    }

    fn update(
        &mut self,
        environment: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        let due = match self.config.replay.steps_per_update {
            0 => self.experience.finished(),
            every => now.env_steps.saturating_sub(self.first) / every,
        };
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        let batch = self.config.replay.batch;
        while self.updates < due {
            self.updates += 1;
            let moves_target = self.updates.is_multiple_of(self.config.update.target_every);
            let update = Update { learning_rate, moves_target };
            let Self { experience, learner, random, .. } = self;
            reports.agents.extend(experience.teach(learner, environment, update, random, batch));
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
        let Learner { online, target, average, optimiser, .. } = &mut self.learner;
        let tensors: Vec<_> = online.shape.tensors().iter().map(Tensor::saved).collect();
        for (name, vector) in [
            ("online", &mut online.parameters),
            ("target", &mut target.parameters),
            ("average", &mut average.parameters),
        ] {
            state.tensors(name, &tensors, vector)?;
        }
        optimiser.state(state, &tensors)?;
        state.value("updates", &mut self.updates)?;
        state.value("random", &mut self.random)?;
        if self.config.network.memory > 0 {
            state.value("memories", &mut self.acting.memories)?;
        }
        self.experience.state(state)
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
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
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
            self.push(scene.instance, scene.begins, &seen);
        }
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{Split, Step};
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
            let transition = Transition {
                environment: ring,
                instance: 0,
                state: &state,
                actions: &[1; 4],
                step: Step { reward, terminated, ..Step::default() },
                task_rewards: &[],
                agent_rewards: &[],
                next: &next,
            };
            method.remember(&transition).unwrap();
            std::mem::swap(&mut state, &mut next);
        }
    }

    /// What an update finds that changes nothing.
    fn found(method: &mut ValueFactorisation, ring: &dyn Environment) -> UpdateReport {
        let ValueFactorisation { learner, experience, random, config, .. } = method;
        let update = Update { learning_rate: 0.0, moves_target: false };
        experience.teach(learner, ring, update, random, config.replay.batch).unwrap()
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
            method.update(&*ring, now, &mut reports).unwrap();
            assert_eq!(reports.agents.len(), 1, "{env_steps}");
            let Learner { online, target, .. } = &method.learner;
            assert_eq!(target == online, copied, "{env_steps}");
            assert_eq!(*target == first, env_steps < 15, "{env_steps}");
        }
    }

    #[test]
    fn what_follows_an_end_is_worth_nothing_and_what_follows_a_time_out_something() {
        let end = |terminated, timed_out| {
            let step = Step { reward: 2.0, terminated, timed_out, ..Step::default() };
            let mut method = seen(&mut *ring(), 32, step);
            let Experience::Steps(replay) = &method.experience else { panic!("steps") };
            let place = replay.draw(1, &mut method.random);
            let future = replay.future(place, 1, 0.5);
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
