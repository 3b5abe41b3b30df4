//! Proximal policy optimisation as a [`Method`].

use sortie_envs::random::shuffle;
use sortie_envs::{ActionSet, Environment, Random, Step, members};
use sortie_learn::export::DeployedAgents;
use sortie_learn::learner::{By, Rules as Following};
use sortie_learn::networks::{best, draw};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports, UpdateReport};
use sortie_learn::session::Opening;
use sortie_learn::trajectory::{Capacity, End, Place, Widths};
use sortie_learn::{
    Act, Ask, LearnError, Learner, Method, Now, Scenes, State, Trajectories, Transition,
};
use sortie_nn::lanes::in_lanes;
use sortie_nn::layers::normalise::Moments;
use sortie_nn::schedule::linear;
use sortie_nn::tape::Tape;

use super::lesson::{Lesson, Rules, advantages};
use super::networks::{Network, Shown};
use super::{Config, ReturnsConfig, UpdateConfig};

/// States of a lesson: so many rows fit into the processor's nearest cache.
const STATES: usize = 32;

/// Agents with one policy, a critic of their team's returns, and what they did since they learned last.
#[derive(Debug)]
pub struct Mappo {
    pub(super) config: Config,
    pub(super) actor: Network,
    pub(super) critic: Network,
    pub(super) policy: Learner<Vec<f32>>,
    pub(super) values: Learner<Vec<f32>>,
    pub(super) rollout: Trajectories,
    /// Steps of all instances in the rollout.
    steps: usize,
    instances: usize,
    acting: Acting,
    /// Draws in which order states are learned from.
    random: Random,
    threads: usize,
}

impl Mappo {
    /// Draws the first weights.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, environment, seed, threads } = *opening;
        let (spec, instances) = (environment.spec(), setup.environment.instances);
        let weights = |index| generator(seed, Purpose::Weights, index);
        let (actor, policy) = Network::new(&config.network, spec, None, &mut weights(0));
        let (critic, values) =
            Network::new(&config.network, spec, Some(config.network.critic), &mut weights(1));
        let following = Following::from(&config.optimiser);
        Self {
            policy: Learner::new(policy, following, threads),
            values: Learner::new(values, following, threads),
            rollout: nothing(&config, instances, spec.shape.agents),
            steps: 0,
            acting: Acting::default(),
            random: generator(seed, Purpose::Replay, 0),
            instances,
            threads,
            actor,
            critic,
            config,
        }
    }

    /// Learns from the rollout.
    fn learn(&mut self, environment: &dyn Environment, now: Now, reports: &mut Reports) {
        let lessons = self.lessons(environment);
        let UpdateConfig { epochs, minibatches, .. } = self.config.update;
        let mut order: Vec<&Lesson> = lessons.iter().collect();
        for _ in 0..epochs {
            shuffle(&mut self.random, &mut order);
            let batches = order.chunks(order.len().div_ceil(minibatches).max(1));
            reports.agents.extend(batches.map(|batch| self.descend(batch, now)));
        }
    }

    /// What there is to learn from the rollout: all decisions, judged.
    pub(super) fn lessons(&mut self, environment: &dyn Environment) -> Vec<Lesson> {
        let rollout = &self.rollout;
        let states: Vec<Place> = (0..self.instances).flat_map(|it| rollout.places(it)).collect();
        let is_end = |(_, place): &(usize, Place)| rollout.end(*place) == End::Nothing;
        let (ends, mut decided): (Vec<_>, Vec<_>) =
            states.iter().copied().enumerate().partition(is_end);
        shuffle(&mut self.random, &mut decided);
        let [mut lessons, ends] = [decided, ends].map(|states| self.look(environment, &states));
        let agents = environment.spec().shape.agents;
        let mut values = vec![f32::NAN; states.len() * agents];
        self.value(&ends, &mut values);
        self.value(&lessons, &mut values);
        values.chunks_exact_mut(agents).for_each(fill_in);
        self.judge(&states, &values, &mut lessons);
        let actor = &self.actor;
        self.policy.look(lessons.len(), By::Online, |shard| {
            let chances = lessons[shard.number].chances(&mut shard.pass, actor);
            *shard.space = shard.pass.values(chances).to_vec();
        });
        for (lesson, logarithms) in lessons.iter_mut().zip(self.policy.spaces()) {
            lesson.logarithms.clone_from(logarithms);
        }
        lessons
    }

    /// Tells lessons how good their decisions were, by what all states were worth.
    fn judge(&self, states: &[Place], values: &[f32], lessons: &mut [Lesson]) {
        let ReturnsConfig { discount, lambda, scale } = self.config.returns;
        let rollout = &self.rollout;
        let left = |place: &Place| (scale * rollout.rewards(*place).team, rollout.end(*place));
        let left: Vec<_> = states.iter().map(left).collect();
        let advantages = advantages(&left, values, [discount, lambda]);
        let decisions = lessons.iter().flat_map(|lesson| &lesson.places);
        let of_decisions: Vec<f32> = decisions.map(|place| advantages[*place]).collect();
        let moments = Moments::of(1, &of_decisions);
        for lesson in lessons {
            lesson.judge(&advantages, values);
            moments.normalise(&mut lesson.advantages);
        }
    }

    /// Looks at states in which somebody acts, so many in a lesson.
    fn look(&self, environment: &dyn Environment, states: &[(usize, Place)]) -> Vec<Lesson> {
        let mut chunks: Vec<_> =
            states.chunks(STATES).map(|states| (states, Lesson::default())).collect();
        in_lanes(self.threads, &mut chunks, |_, (states, lesson)| {
            *lesson = Lesson::of(environment, &self.rollout, states);
        });
        let lessons = chunks.into_iter().map(|(_, lesson)| lesson);
        lessons.filter(|lesson| !lesson.places.is_empty()).collect()
    }

    /// Writes `[states, A]` what the states of lessons are worth to those that act.
    fn value(&mut self, lessons: &[Lesson], values: &mut [f32]) {
        let critic = &self.critic;
        self.values.look(lessons.len(), By::Online, |shard| {
            let found = critic.numbers(&mut shard.pass, &lessons[shard.number].shown);
            *shard.space = shard.pass.values(found).to_vec();
        });
        for (lesson, found) in lessons.iter().zip(self.values.spaces()) {
            lesson.places.iter().zip(found).for_each(|(place, value)| values[*place] = *value);
        }
    }

    /// Makes an update of actor and critic by some of the lessons.
    fn descend(&mut self, batch: &[&Lesson], now: Now) -> UpdateReport {
        let Self { config, actor, critic, policy, values, .. } = self;
        let UpdateConfig { clip, entropy: [start, end], .. } = config.update;
        let entropy = linear(start, end, now.of, now.env_steps);
        let decisions = batch.iter().map(|lesson| lesson.places.len()).sum();
        let rules = Rules { decisions, clip, entropy };
        let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
        let of_actor = policy.update(batch.len(), rate, |shard| {
            batch[shard.number].actor_loss(&mut shard.pass, actor, rules)
        });
        let of_critic = values.update(batch.len(), rate, |shard| {
            batch[shard.number].critic_loss(&mut shard.pass, critic, rules)
        });
        let gradient_norm = of_actor.gradient_norm.hypot(of_critic.gradient_norm);
        UpdateReport { loss: of_actor.loss + of_critic.loss, gradient_norm }
    }
}

/// A rollout of no steps, of which each may end an episode, whose last state is kept as well.
fn nothing(config: &Config, instances: usize, agents: usize) -> Trajectories {
    let capacity = Capacity::States(2 * config.rollout.steps);
    Trajectories::new(capacity, instances, Widths { agents, ..Widths::default() })
}

/// To agents that do not act a state is worth what it is to the others on average; nothing where nobody acts.
fn fill_in(team: &mut [f32]) {
    let acting = || team.iter().filter(|value| !value.is_nan());
    let mean = acting().sum::<f32>() / acting().count().max(1) as f32;
    team.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = mean);
}

impl Method for Mappo {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>, _: Now) -> Result<(), LearnError> {
        let network = (&self.actor, &*self.policy.online.values);
        self.acting.act(network, scenes, actions, |scores, open, instance| {
            draw(scores, open, &mut random[instance])
        });
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.steps += 1;
        let Step { terminated, timed_out, .. } = transition.step;
        // A rollout is cut off as if time ran out: what follows its last step is worth something.
        let is_last = self.steps > (self.config.rollout.steps - 1) * self.instances;
        let step = Step { timed_out: timed_out || is_last && !terminated, ..transition.step };
        self.rollout.push(&Transition { step, ..*transition });
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let mut reports = Reports::default();
        if self.steps == self.config.rollout.steps * self.instances {
            self.learn(environment, now, &mut reports);
            let agents = environment.spec().shape.agents;
            self.rollout = nothing(&self.config, self.instances, agents);
            self.steps = 0;
        }
        Ok(reports)
    }

    fn rates(&self, now: Now) -> Rates {
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon: 0.0, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        let network = (&self.actor, &*self.policy.average);
        Box::new(Greedy { network, acting: Acting::default() })
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

/// Buffers for the decisions of any number of teams at once.
#[derive(Debug, Default)]
struct Acting {
    shown: Shown,
    tape: Tape,
}

impl Acting {
    /// Writes `[scenes, A]` actions, each of them chosen by an agent's scores, what is available to it, and its instance.
    fn act(
        &mut self,
        (actor, weights): (&Network, &[f32]),
        scenes: &Scenes<'_>,
        actions: &mut [u16],
        mut choose: impl FnMut(&[f32], ActionSet, usize) -> usize,
    ) {
        let Self { shown, tape } = self;
        let team = scenes.environment.spec().shape.agents;
        let mut due = Vec::new();
        shown.clear();
        for (place, scene) in scenes.scenes.iter().enumerate() {
            let acting = shown.push(scenes.environment, scene.state);
            let actions = &mut actions[place * team..][..team];
            // Who does not act has nothing to choose from.
            let open = shown.latest().iter().map(|open| open.trailing_zeros() as u16);
            actions.iter_mut().zip(open).for_each(|(action, open)| *action = open);
            let chooses = |agent| (place * team + agent, scene.instance);
            due.extend(members(acting.into()).map(chooses));
        }
        if due.is_empty() {
            return;
        }
        shown.finish(scenes.environment.spec());
        let mut pass = tape.begin_forward(weights);
        let scores = actor.numbers(&mut pass, shown);
        let rows = pass.values(scores).chunks_exact(pass.size(scores)[1]);
        for ((scores, open), (place, instance)) in rows.zip(shown.available()).zip(due) {
            actions[place] = choose(scores, *open, instance) as u16;
        }
    }
}

/// Agents that take the best action that they know.
#[derive(Debug)]
struct Greedy<'a> {
    /// The actor and its weights.
    network: (&'a Network, &'a [f32]),
    acting: Acting,
}

impl Act for Greedy<'_> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<(), LearnError> {
        self.acting.act(self.network, scenes, actions, |scores, open, _| best(scores, open));
        Ok(())
    }
}
