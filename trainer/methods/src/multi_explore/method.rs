//! The published learner as a [`Method`].

use sortie_envs::{Environment, Observation, Random};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};

use super::config::Config;
use super::meta::MetaPolicy;
use super::moments::Moments;
use crate::actor_critic::acting::{Acting, Actors, Inputs, observe, observed};
use crate::actor_critic::deployed::deployed;
use crate::actor_critic::experience::{Experience, Rule};
use crate::actor_critic::heads::{HeadBatch, HeadLearner};
use crate::actor_critic::replay::{Future, Replay};
use crate::actor_critic::running::Running;
use crate::novelty::counts::Counts;
use crate::novelty::intrinsic::Intrinsic;
use crate::novelty::places::{CELLS, Columns};

/// Agents of several heads, and what they have seen.
#[derive(Debug)]
pub struct MultiExplore {
    config: Config,
    columns: Columns,
    heads: Vec<Option<Intrinsic>>,
    learner: HeadLearner,
    experience: Experience,
    meta: MetaPolicy,
    counts: Counts,
    /// By agents and heads: intrinsic rewards of what happened.
    moments: Vec<Moments>,
    episodes: Vec<Episode>,
    /// Discounted returns of the episodes of this turn that ended.
    turn: Vec<f64>,
    /// What agents saw in all that was stepped into since the last update, one behind the other.
    stepped: Vec<f32>,
    seen: Observation,
    /// Draws records, actions and heads.
    random: Random,
    began: Option<u64>,
    updates: u64,
    batch: HeadBatch,
    /// What networks are shown is as it is.
    unchanged: Running,
}

/// What the running episode of an instance returned.
#[derive(Clone, Copy, Debug, Default, serde::Serialize, serde::Deserialize)]
struct Episode {
    discounted: f64,
    /// What a reward of the next step counts.
    discount: f64,
}

const INPUTS: Inputs = Inputs { normalised: false, scale: 1.0 };

impl MultiExplore {
    /// Draws the first weights.
    ///
    /// # Panics
    /// The environment shows no places.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, environment, seed, threads } = *opening;
        let spec = environment.spec();
        let mut weights = generator(seed, Purpose::Weights, 0);
        let networks = Columns::of(spec).zip(config.learner(spec, threads, &mut weights));
        let (columns, learner) = networks.expect("the environment was found to fit");
        let (agents, instances) = (learner.groups.agents(), setup.environment.instances);
        let heads = config.heads();
        let capacity = config.replay.capacity.div_ceil(instances);
        let replay = Replay::new(instances, capacity, agents, observed(&learner.groups));
        let rule = Rule { interval: 1, discount: 1.0, shaping: 0.0 };
        let mut random = generator(seed, Purpose::Replay, 0);
        Self {
            unchanged: Running::new(&learner.groups),
            learner,
            experience: Experience::new(rule, instances, replay),
            meta: MetaPolicy::new(heads.len(), &mut random),
            counts: Counts::new(agents, CELLS, heads.contains(&Some(Intrinsic::Centralized))),
            moments: vec![Moments::default(); agents * heads.len()],
            episodes: vec![Episode::default(); instances],
            turn: Vec::new(),
            stepped: Vec::new(),
            seen: Observation::new(&spec.shape),
            began: None,
            updates: 0,
            batch: HeadBatch::default(),
            random,
            columns,
            heads,
            config,
        }
    }

    /// The policies of the head that is deployed.
    fn best(&self) -> Actors<'_> {
        actors(&self.learner, self.meta.best(), &self.unchanged)
    }

    /// Looks what all agents see in a state and counts them there; keeps that if they stepped into it.
    fn visit(&mut self, environment: &dyn Environment, state: &[u8], is_step: bool) {
        let start = self.stepped.len();
        observe(environment, &self.learner.groups, state, &mut self.seen, &mut self.stepped);
        self.counts.visit(self.columns.cells(&self.stepped[start..]));
        if !is_step {
            self.stepped.truncate(start);
        }
    }

    /// Adds by agents and heads what each is paid where all see this, not normalised yet.
    fn pay(&self, observation: &[f32], paid: &mut [Vec<f32>]) {
        let cells = || self.columns.cells(observation);
        let team = self.counts.team_novelty(cells());
        for (agent, cell) in cells().enumerate() {
            let novelties = self.counts.novelties(cell);
            for (head, kind) in self.heads.iter().enumerate() {
                let paid = &mut paid[agent * self.heads.len() + head];
                paid.extend(kind.map(|kind| kind.reward(novelties, team, agent)));
            }
        }
    }

    /// Adds what was paid for the last steps to the moments of intrinsic rewards.
    fn add_moments(&mut self) {
        let stepped = std::mem::take(&mut self.stepped);
        let mut paid = vec![Vec::new(); self.moments.len()];
        for observation in stepped.chunks_exact(observed(&self.learner.groups)) {
            self.pay(observation, &mut paid);
        }
        for (moments, paid) in self.moments.iter_mut().zip(paid) {
            let paid: Vec<f64> = paid.into_iter().map(f64::from).collect();
            if !paid.is_empty() {
                moments.add(&paid);
            }
        }
        self.stepped = stepped;
        self.stepped.clear();
    }

    /// Draws records for an update. Intrinsic rewards are those of today, in today's deviations.
    fn gather(&mut self) {
        let (mut batch, mut future) = (std::mem::take(&mut self.batch), Future::default());
        let groups = &self.learner.groups;
        batch.records.clear(groups);
        batch.states.iter_mut().for_each(Vec::clear);
        batch.own.resize_with(self.moments.len(), Vec::new);
        batch.own.iter_mut().for_each(Vec::clear);
        for _ in 0..self.config.replay.batch {
            let replay = &self.experience.replay;
            let place = replay.draw(1, &mut self.random);
            replay.future(place, 1, false, &mut future);
            batch.records.add(groups, INPUTS, replay, place, &future);
            let next = replay.observation(place.next());
            let [state, next_state] = &mut batch.states;
            self.columns.write_state(replay.observation(place), state);
            self.columns.write_state(next, next_state);
            self.pay(next, &mut batch.own);
        }
        for (own, moments) in batch.own.iter_mut().zip(&self.moments) {
            let deviation = moments.variance.sqrt() as f32;
            own.iter_mut().for_each(|reward| *reward /= deviation);
        }
        self.batch = batch;
    }
}

/// The policies of a head.
fn actors<'a>(learner: &'a HeadLearner, head: usize, running: &'a Running) -> Actors<'a> {
    let HeadLearner { groups, policies, .. } = learner;
    let weights = &policies.parameters.values;
    Actors { groups, inputs: INPUTS, policies, head, weights, running }
}

impl Method for MultiExplore {
    /// All act by one head, an episode of every instance.
    fn waits(&self) -> bool {
        true
    }

    fn learns_while_waiting(&self) -> bool {
        true
    }

    fn begins(&mut self, instance: usize, _: &mut Random) {
        self.episodes[instance] = Episode { discounted: 0.0, discount: 1.0 };
    }

    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        for scene in scenes.scenes.iter().filter(|scene| scene.begins) {
            self.visit(scenes.environment, scene.state, false);
        }
        let actors = actors(&self.learner, self.meta.head, &self.unchanged);
        self.experience.act(actors, scenes, random, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let Transition { environment, instance, step, next, .. } = *transition;
        self.visit(environment, next, true);
        let groups = &self.learner.groups;
        let rewards = vec![step.reward; groups.agents()];
        self.experience.remember(groups, &rewards, transition);
        let episode = &mut self.episodes[instance];
        episode.discounted += episode.discount * step.reward;
        episode.discount *= f64::from(self.config.returns.discount);
        if step.done() {
            self.turn.push(episode.discounted);
        }
        if self.turn.len() == self.episodes.len() {
            self.meta.learn(&self.config.meta, &self.turn);
            self.meta.draw(self.config.meta.uniform, &mut self.random);
            self.turn.clear();
        }
        Ok(())
    }

    fn update(
        &mut self,
        _: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        self.add_moments();
        let rule = &self.config.replay;
        if self.began.is_none() && self.experience.replay.decisions() >= rule.batch {
            self.began = Some(now.env_steps);
        }
        let Some(began) = self.began else { return Ok(()) };
        let due = (now.env_steps - began) / rule.steps_per_period * rule.updates_per_period;
        while self.updates < due {
            self.updates += 1;
            self.gather();
            reports.agents.push(self.learner.update(&self.batch, &mut self.random));
        }
        Ok(())
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: 0.0, learning_rate: self.config.optimiser.policy_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy { actors: self.best(), acting: Acting::default() })
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        let actors = self.best();
        Ok(deployed(actors, actors.groups.0[0].actions))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state(state)?;
        self.experience.state(state)?;
        state.kept("meta-policy", &mut self.meta)?;
        state.value("counts", &mut self.counts)?;
        state.value("moments", &mut self.moments)?;
        state.value("episodes", &mut self.episodes)?;
        state.value("turn", &mut self.turn)?;
        state.value("random", &mut self.random)?;
        state.value("began", &mut self.began)?;
        state.value("updates", &mut self.updates)
    }
}

/// Agents that take the action that they think the likeliest, by one head.
struct Greedy<'a> {
    actors: Actors<'a>,
    acting: Acting,
}

impl Act for Greedy<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let groups = self.actors.groups;
        self.acting.look(self.actors, scenes.environment, scenes.scenes.iter());
        for (place, actions) in actions.chunks_exact_mut(groups.agents()).enumerate() {
            self.acting.choose(groups, place, None, actions);
        }
        Ok(())
    }
}
