//! Proximal policy optimisation as a [`Method`].

use sortie_envs::random::{below, shuffle};
use sortie_envs::{Environment, Random, Step};
use sortie_learn::export::DeployedAgents;
use sortie_learn::learner::{By, Rules as Following};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports, UpdateReport};
use sortie_learn::session::Opening;
use sortie_learn::trajectory::{Capacity, Place, Widths};
use sortie_learn::{
    Act, LearnError, Learner, Method, Now, Scenes, State, Trajectories, Transition,
};
use sortie_nn::lanes::in_lanes;
use sortie_nn::schedule::linear;

use super::acting::{Acting, Greedy};
use super::lesson::{Left, Lesson, Rules, advantages};
use super::networks::Network;
use super::{Config, UpdateConfig};

/// States of a lesson: so many rows fit into the processor's nearest cache.
const STATES: usize = 32;

/// Agents with one policy, a critic of their team's returns, and what they did since they learned last.
#[derive(Debug)]
pub struct Mappo {
    config: Config,
    actor: Network,
    critic: Network,
    policy: Learner<Vec<f32>>,
    values: Learner<Vec<f32>>,
    /// The symmetry by which agents saw each state is noted with it.
    rollout: Trajectories<u8>,
    /// Steps of the rollout, and of the last of all instances those before.
    steps: usize,
    instances: usize,
    lessons: Vec<Lesson>,
    acting: Acting,
    /// Draws in which order states are learned from.
    random: Random,
    threads: usize,
}

impl Mappo {
    /// Draws the first weights.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, environment, seed, threads } = *opening;
        let spec = environment.spec();
        let instances = setup.environment.instances;
        let network = |index| generator(seed, Purpose::Weights, index);
        let (actor, policy) = Network::actor(&config.network, spec, &mut network(0));
        let (critic, values) = Network::critic(&config.network, spec, &mut network(1));
        let following = Following::from(&config.optimiser);
        Self {
            policy: Learner::new(policy, following, threads),
            values: Learner::new(values, following, threads),
            rollout: empty(&config, instances, spec.shape.agents),
            steps: 0,
            instances,
            lessons: Vec::new(),
            acting: Acting::default(),
            random: generator(seed, Purpose::Replay, 0),
            threads,
            actor,
            critic,
            config,
        }
    }

    /// Learns from the rollout.
    fn learn(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        self.look(environment);
        let UpdateConfig { epochs, minibatches, .. } = self.config.update;
        let decides = |lesson: &usize| self.lessons[*lesson].decisions() > 0;
        let mut order: Vec<usize> = (0..self.lessons.len()).filter(decides).collect();
        for _ in 0..epochs {
            shuffle(&mut self.random, &mut order);
            for batch in order.chunks(order.len().div_ceil(minibatches).max(1)) {
                reports.agents.push(self.descend(batch, now));
            }
        }
    }

    /// Fills lessons with all states, and judges what was decided in them.
    fn look(&mut self, environment: &dyn Environment) {
        let Self { config, rollout, lessons, random, threads, .. } = self;
        let agents = environment.spec().shape.agents;
        let places: Vec<Place> =
            (0..self.instances).flat_map(|instance| kept(rollout, instance)).collect();
        let mut order: Vec<(usize, Place)> = places.iter().copied().enumerate().collect();
        shuffle(random, &mut order);
        let chunks: Vec<&[(usize, Place)]> = order.chunks(STATES).collect();
        lessons.resize_with(chunks.len(), Lesson::default);
        in_lanes(*threads, lessons, |number, lesson| {
            lesson.fill(environment, rollout, chunks[number].iter());
        });

        let (actor, critic) = (&self.actor, &self.critic);
        self.policy.look(lessons.len(), By::Online, |shard| {
            shard.space.clear();
            let lesson = &lessons[shard.number];
            if lesson.decisions() > 0 {
                let chances = lesson.chances(&mut shard.pass, actor);
                shard.space.extend_from_slice(shard.pass.values(chances));
            }
        });
        self.values.look(lessons.len(), By::Online, |shard| {
            shard.space.clear();
            let lesson = &lessons[shard.number];
            if lesson.shown.agents() > 0 {
                let values = critic.numbers(&mut shard.pass, &lesson.shown);
                shard.space.extend_from_slice(shard.pass.values(values));
            }
        });
        let mut values = vec![f32::NAN; places.len() * agents];
        for (lesson, found) in lessons.iter_mut().zip(self.values.spaces()) {
            lesson.places.iter().zip(found).for_each(|(place, value)| values[*place] = *value);
        }
        values.chunks_exact_mut(agents).for_each(fill_in);
        let left = |place: &Place| -> Left {
            (config.returns.scale * rollout.rewards(*place).team, rollout.end(*place))
        };
        let left: Vec<Left> = places.iter().map(left).collect();
        let discounts = [config.returns.discount, config.returns.lambda];
        let advantages = advantages(&left, &values, discounts);
        for (lesson, logarithms) in lessons.iter_mut().zip(self.policy.spaces()) {
            lesson.keep(logarithms);
            lesson.judge(&advantages, &values);
        }
        normalise(lessons);
    }

    /// Makes an update of actor and critic by some of the lessons.
    fn descend(&mut self, batch: &[usize], now: Now) -> UpdateReport {
        let Self { config, lessons, actor, critic, policy, values, .. } = self;
        let decisions = batch.iter().map(|lesson| lessons[*lesson].decisions()).sum();
        let UpdateConfig { clip, entropy: [start, end], .. } = config.update;
        let entropy = linear(start, end, now.of, now.env_steps);
        let rules = Rules { decisions, clip, entropy };
        let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
        let of_actor = policy.update(batch.len(), rate, |shard| {
            lessons[batch[shard.number]].actor_loss(&mut shard.pass, actor, rules)
        });
        let of_critic = values.update(batch.len(), rate, |shard| {
            lessons[batch[shard.number]].critic_loss(&mut shard.pass, critic, decisions)
        });
        let gradient_norm = of_actor.gradient_norm.hypot(of_critic.gradient_norm);
        UpdateReport { loss: of_actor.loss + of_critic.loss, gradient_norm }
    }
}

/// A rollout of no steps, of which each may end an episode, whose last state is kept as well.
fn empty(config: &Config, instances: usize, agents: usize) -> Trajectories<u8> {
    let capacity = Capacity::States(2 * config.rollout.steps);
    Trajectories::noting(capacity, instances, Widths { agents, ..Widths::default() })
}

/// The states of an instance.
fn kept(rollout: &Trajectories<u8>, instance: usize) -> impl Iterator<Item = Place> {
    let first = rollout.oldest(instance);
    (0..).map(move |steps| first.after(steps)).take_while(|place| rollout.has(*place))
}

/// What a state is worth to agents that do not act in it: as much as to the others on average; nothing where nobody acts.
fn fill_in(team: &mut [f32]) {
    let (sum, count) = team
        .iter()
        .filter(|value| !value.is_nan())
        .fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    let mean = sum / f32::max(count, 1.0);
    team.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = mean);
}

/// Gives the advantages of all decisions a mean of 0 and a deviation of 1.
fn normalise(lessons: &mut [Lesson]) {
    let all = || lessons.iter().flat_map(|lesson| &lesson.advantages).map(|it| f64::from(*it));
    let count = all().count().max(1) as f64;
    let mean = all().sum::<f64>() / count;
    let variance = all().map(|advantage| (advantage - mean).powi(2)).sum::<f64>() / count;
    let factor = 1.0 / (variance.sqrt() + 1e-8);
    for advantage in lessons.iter_mut().flat_map(|lesson| &mut lesson.advantages) {
        *advantage = (factor * (f64::from(*advantage) - mean)) as f32;
    }
}

impl Method for Mappo {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let turns =
            if self.config.rollout.symmetries { scenes.environment.spec().turns } else { 1 };
        self.acting.turns.resize(self.instances, 0);
        // Where nothing is symmetric nothing is drawn.
        for scene in scenes.scenes.iter().filter(|_| turns > 1) {
            self.acting.turns[scene.instance] = below(&mut random[scene.instance], turns) as u8;
        }
        self.acting.act((&self.actor, &self.policy.online.values), scenes, Some(random), actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.steps += 1;
        let Step { terminated, timed_out, .. } = transition.step;
        // A rollout is cut off as if time ran out: what follows its last step is worth something.
        let is_last = self.steps > (self.config.rollout.steps - 1) * self.instances;
        let timed_out = timed_out || is_last && !terminated;
        let step = Step { timed_out, ..transition.step };
        let turn = self.acting.turns[transition.instance];
        self.rollout.push_noted(&Transition { step, ..*transition }, turn);
        Ok(())
    }

    fn update(
        &mut self,
        environment: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        if self.steps == self.config.rollout.steps * self.instances {
            self.learn(environment, now, reports);
            let agents = environment.spec().shape.agents;
            self.rollout = empty(&self.config, self.instances, agents);
            self.steps = 0;
        }
        Ok(())
    }

    fn rates(&self, now: Now) -> Rates {
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon: 0.0, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        let network = (&self.actor, &*self.policy.average);
        Box::new(Greedy::new(network))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.policy.state_as(state, |part| format!("actor/{part}"))?;
        self.values.state_as(state, |part| format!("critic/{part}"))?;
        state.value("steps", &mut self.steps)?;
        state.value("random", &mut self.random)?;
        self.rollout.visit_as(state, "rollout")
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Ok(self.actor.deployed(&self.policy.average))
    }
}
