//! What agents do and earn while they learn: decisions, each of which holds for some steps; and what an update sees of them.

use serde::{Deserialize, Serialize};
use sortie_envs::{EntitySet, Environment, Observation, Random, Spec};
use sortie_learn::trajectory::{Capacity, End, Episode, Place, Widths};
use sortie_learn::{LearnError, Scene, Scenes, State, Trajectories, Transition};

use super::{Config, ReturnsConfig};
use crate::actor_critic::acting::{Acting, Actors, show};
use crate::actor_critic::critic::Batch;
use crate::actor_critic::learner::ActorCritic;

/// Decisions of all instances, those that hold and those that are kept.
#[derive(Debug)]
pub(super) struct Experience {
    returns: ReturnsConfig,
    /// What the value behind a decision counts, and where the time ran out.
    discounts: [f32; 2],
    /// A step of each is a decision.
    pub(super) replay: Trajectories,
    running: Vec<Decision>,
    acting: Acting,
    chosen: Vec<u16>,
    seen: Observation,
}

/// A decision that holds.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Decision {
    /// The state in which it was made.
    state: Vec<u8>,
    /// `[A]`
    actions: Vec<u16>,
    /// Steps that it still holds for.
    left: usize,
    /// `[A]`: what each has earned by it.
    rewards: Vec<f64>,
    /// What a reward of the next step counts.
    discount: f32,
    /// How near each agent was to what it is after.
    potentials: Vec<f32>,
}

impl Decision {
    /// Looks how near each agent is to what it is after, by which rewards are shaped on this scale.
    fn look(&mut self, environment: &dyn Environment, state: &[u8], scale: f32) {
        self.potentials.clear();
        self.potentials.resize(self.actions.len(), 0.0);
        if scale != 0.0 {
            environment.potentials(state, scale, &mut self.potentials);
        }
    }

    /// Adds how much nearer each agent came since it last looked.
    fn shape(&mut self, environment: &dyn Environment, state: &[u8], scale: f32) {
        let before = std::mem::take(&mut self.potentials);
        self.look(environment, state, scale);
        for ((sum, before), after) in self.rewards.iter_mut().zip(before).zip(&self.potentials) {
            *sum += f64::from(self.discount * *after - before);
        }
    }
}

impl Experience {
    /// Nothing was decided yet in so many instances.
    pub(super) fn new(config: &Config, spec: &Spec, instances: usize) -> Self {
        let returns = config.returns.clone();
        let (limit, interval) = (spec.episode_limit as usize, returns.decision_interval);
        // The time of all episodes runs out after as many steps, so that the last decision is cut short by as many.
        let steps = [interval, (limit.max(1) - 1) % interval + 1];
        let capacity = config.replay.capacity;
        let capacity = if config.replay.on_policy {
            Capacity::Episodes((capacity / limit.div_ceil(interval)).max(instances))
        } else {
            Capacity::States(capacity.div_ceil(instances))
        };
        let agents = spec.shape.agents;
        let widths = Widths { agents, earners: agents, ..Widths::default() };
        Self {
            discounts: steps.map(|steps| returns.discount.powi(steps as i32)),
            returns,
            replay: Trajectories::new(capacity, instances, widths),
            running: vec![Decision::default(); instances],
            acting: Acting::default(),
            chosen: Vec::new(),
            seen: Observation::default(),
        }
    }

    /// Has agents choose where no decision holds, and writes `[scenes, A]` what they do.
    pub(super) fn act(
        &mut self,
        actors: Actors<'_>,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) {
        let Self { returns, running, acting, chosen, .. } = self;
        let decides = |scene: &&Scene<'_>| scene.begins || running[scene.instance].left == 0;
        let deciding: Vec<Scene<'_>> = scenes.scenes.iter().filter(decides).copied().collect();
        let agents = actors.groups.agents();
        chosen.resize(deciding.len() * agents, 0);
        if !deciding.is_empty() {
            let scenes = Scenes { scenes: &deciding, ..*scenes };
            acting.act(actors, &scenes, Some(random), chosen);
        }
        for (scene, chosen) in deciding.iter().zip(chosen.chunks_exact(agents)) {
            let decision = &mut running[scene.instance];
            (decision.left, decision.discount) = (returns.decision_interval, 1.0);
            decision.state.clear();
            decision.state.extend_from_slice(scene.state);
            decision.actions.clear();
            decision.actions.extend_from_slice(chosen);
            decision.rewards.clear();
            decision.rewards.resize(agents, 0.0);
            if scene.begins {
                decision.look(scenes.environment, scene.state, returns.shaping);
            }
        }
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            let decision = &mut running[scene.instance];
            actions.copy_from_slice(&decision.actions);
            decision.left -= 1;
        }
    }

    /// Adds what a step earned each agent, and the decision that it ended.
    pub(super) fn remember(&mut self, transition: &Transition<'_>) {
        let Transition { environment, instance, step, next, .. } = *transition;
        let (returns, decision) = (&self.returns, &mut self.running[instance]);
        for (sum, reward) in decision.rewards.iter_mut().zip(transition.agent_rewards) {
            *sum += f64::from(decision.discount) * reward;
        }
        decision.discount *= returns.discount;
        if decision.left > 0 && !step.done() {
            return;
        }
        decision.shape(environment, next, returns.shaping);
        let Decision { state, actions, rewards, .. } = &*decision;
        self.replay.push(&Transition { state, actions, agent_rewards: rewards, ..*transition });
    }

    /// Draws records for an update, or takes the episodes that all instances just ended.
    pub(super) fn gather(
        &mut self,
        environment: &dyn Environment,
        config: &Config,
        learner: &ActorCritic,
        random: &mut Random,
        batch: &mut Batch,
    ) {
        batch.clear(learner.sizes());
        let places: Vec<Place> = if config.replay.on_policy {
            let mut episodes: Vec<Episode> = self.replay.latest(self.running.len()).collect();
            episodes.sort_unstable_by_key(|episode| episode.first);
            let steps = |Episode { first, steps }: Episode| {
                (1..=steps).map(move |step| (first.after(step - 1), step < steps))
            };
            let steps = || episodes.iter().copied().flat_map(steps);
            batch.follows.extend(steps().map(|(_, goes_on)| goes_on));
            steps().map(|(place, _)| place).collect()
        } else {
            (0..config.replay.batch).map(|_| self.replay.draw(self.returns.steps, random)).collect()
        };
        let (groups, scale) = (&learner.groups, config.inputs(None).scale);
        let mut earned = vec![0.0; groups.agents()];
        for place in places {
            let (next, discount) = self.follow(place, &mut earned);
            batch.add(groups, self.replay.actions(place), |agent| earned[agent], discount);
            for (place, shown) in [(place, &mut batch.observations), (next, &mut batch.next)] {
                let state = self.replay.state(place);
                environment.observe(state, 0, EntitySet::MAX, &mut self.seen);
                show(groups, scale, &self.seen, shown);
            }
        }
    }

    /// Writes `[A]` what agents earned from a decision on within so many, or until their episode ended, in deviations of
    /// what is kept. Returns where they were then, and what its value counts.
    fn follow(&self, mut place: Place, earned: &mut [f32]) -> (Place, f32) {
        let mut discount = 1.0;
        earned.fill(0.0);
        for _ in 0..self.returns.steps {
            let (end, rewards) = (self.replay.end(place), self.replay.rewards(place).agents);
            for (agent, (sum, reward)) in earned.iter_mut().zip(rewards).enumerate() {
                *sum += discount * self.replay.in_deviations(agent, *reward);
            }
            let [whole, last] = self.discounts;
            discount *= match end {
                End::Open => whole,
                End::TimedOut => last,
                End::Over | End::Nothing => 0.0,
            };
            place = place.after(1);
            if end != End::Open {
                break;
            }
        }
        (place, discount)
    }

    /// Names what the rest of a run depends on.
    pub(super) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.replay.visit(state)?;
        state.value("decisions", &mut self.running)
    }
}
