//! The loss of some of what an update learns from.
//!
//! `(1 - lambda) (Q - y)^2 + lambda (Q_imagined - y)^2`, with one target `y` for both: the n-step reward
//! and the target networks' value of the actions that the online network prefers (double Q-learning),
//! from what is really seen (dissertation equation 5.10).

use sortie_envs::{EntitySet, Observation};
use sortie_learn::learner::{Loss, Shard};
use sortie_learn::networks::{
    AgentShape, BLOCKS, EntityAgent, EntityBatch, Mixer, MixerShape, best,
};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Parameters, Var};

/// Sizes of agents and mixer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkShape {
    /// The agents' network.
    pub agent: AgentShape,
    /// The mixer.
    pub mixer: MixerShape,
}

/// The layers of agents and mixer.
#[derive(Clone, Debug)]
pub struct Networks {
    /// The agents.
    pub agents: EntityAgent,
    /// The mixer.
    pub mixer: Mixer,
}

impl Networks {
    /// Draws all weights, the agents' first.
    pub fn new(shape: NetworkShape, random: &mut Generator) -> (Self, Parameters) {
        let mut parameters = Parameters::default();
        let agents = EntityAgent::new(&mut parameters, shape.agent, random);
        let mixer = Mixer::new(&mut parameters, shape.mixer, random);
        (Self { agents, mixer }, parameters)
    }
}

/// Records or whole episodes to learn from, and the memory for it.
#[derive(Clone, Debug, Default)]
pub struct Lesson {
    /// The states in which the actions were taken.
    pub before: EntityBatch,
    /// The actions of all agents in them.
    pub actions: Vec<u32>,
    /// The discounted rewards until the states after.
    pub rewards: Vec<f32>,
    /// The states n steps later, or where the episode ended; none of whole episodes, which have them among those before.
    pub after: EntityBatch,
    /// Where the state after each of them stands; none for the last of an episode, in which nothing was done.
    pub next: Vec<Option<u32>>,
    /// What the value of the state after counts: the discount, or 0 where it is worth nothing.
    pub discounts: Vec<f32>,
    /// What was found.
    pub losses: Losses,
    pub(super) seen: Observation,
    pub(super) companions: Vec<EntitySet>,
    taken: Vec<u32>,
    preferred: Vec<u32>,
    /// The states in which something was done, and the targets of their values.
    learnt: Vec<u32>,
    pub(super) targets: Vec<f32>,
    memory: Vec<f32>,
}

/// Sums over a lesson.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Of the squared errors.
    pub real: f64,
    /// Of the squared errors of imagined values.
    pub imagined: f64,
    /// Of the targets.
    pub targets: f64,
}

impl Lesson {
    /// Forgets all records, keeps the memory.
    pub fn clear(&mut self) {
        self.before.clear();
        self.actions.clear();
        self.rewards.clear();
        self.after.clear();
        self.next.clear();
        self.discounts.clear();
    }
}

impl Networks {
    /// The part that a lesson has in the mean loss over `records`.
    ///
    /// `imagined` is lambda, or `None` where nothing is imagined.
    pub fn loss(
        &self,
        shard: &mut Shard<'_, Lesson>,
        imagined: Option<f32>,
        records: usize,
    ) -> Loss {
        let Lesson { before, memory, .. } = &mut *shard.space;
        let view = if imagined.is_some() { before.seen() } else { before.seen().whole() };
        self.forget(memory, before.slots(view));
        let utilities = self.agents.utilities(&mut shard.pass, before, view, memory);
        self.find_targets(shard, utilities);

        let Shard { pass, space: lesson, .. } = shard;
        let Lesson { before, actions, taken, learnt, targets, losses, .. } = &mut **lesson;
        let blocks = if imagined.is_some() { BLOCKS } else { 1 };
        taken.clear();
        (0..blocks).for_each(|_| taken.extend_from_slice(actions));
        let chosen = pass.pick(utilities, taken);
        let mixed = self.mixer.mix(pass, before.teams(), chosen);
        let lambda = imagined.unwrap_or(0.0);
        let mut part = |values: Var, weight: f32| {
            let values = pass.gather(values, learnt);
            let pairs = pass.values(values).iter().zip(&*targets);
            let squares: f64 = pairs.map(|(value, y)| f64::from((value - y) * (value - y))).sum();
            (pass.squared_error(values, targets, weight / records as f32), squares)
        };
        let (real, imagined) =
            (part(mixed.real, 1.0 - lambda), mixed.imagined.map(|values| part(values, lambda)));
        losses.real = real.1;
        losses.imagined = imagined.map_or(0.0, |(_, squares)| squares);
        losses.targets = targets.iter().map(|target| f64::from(*target)).sum();
        let total = imagined.map_or(real.0, |(imagined, _)| pass.add(real.0, imagined));
        Loss { total, reported: losses.real / records as f64 }
    }

    /// Agents begin with memories of nothing.
    fn forget(&self, memory: &mut Vec<f32>, slots: usize) {
        memory.clear();
        memory.resize(slots * self.agents.shape.memory, 0.0);
    }

    /// The targets of a lesson. Of whole episodes the online network's utilities are known.
    fn find_targets(&self, shard: &mut Shard<'_, Lesson>, utilities: Var) {
        let Shard { pass, spare, online, target, space: lesson, .. } = shard;
        let Lesson { before, after, preferred, memory, .. } = &mut **lesson;
        let is_whole = after.is_empty();
        let after: &EntityBatch = if is_whole { before } else { after };
        let view = after.seen().whole();
        let mut prefer = |utilities: &[f32]| {
            let agents = utilities.chunks_exact(self.agents.shape.actions).zip(after.available());
            preferred.clear();
            preferred.extend(agents.map(|(utilities, open)| best(utilities, *open) as u32));
        };
        if is_whole {
            prefer(pass.values(utilities));
        } else {
            let mut values = spare.begin_forward(online);
            self.forget(memory, after.slots(view));
            let utilities = self.agents.utilities(&mut values, after, view, memory);
            prefer(values.values(utilities));
        }
        let mut values = spare.begin_forward(target);
        self.forget(memory, after.slots(view));
        let utilities = self.agents.utilities(&mut values, after, view, memory);
        let chosen = values.pick(utilities, preferred);
        let worth = self.mixer.mix(&mut values, after.teams(), chosen).real;
        let worth = values.values(worth);

        let Lesson { rewards, discounts, next, learnt, targets, .. } = &mut **lesson;
        learnt.clear();
        targets.clear();
        for (state, next) in next.iter().enumerate() {
            let Some(next) = next else { continue };
            learnt.push(state as u32);
            targets.push(rewards[state] + discounts[state] * worth[*next as usize]);
        }
    }
}
