//! The loss of a batch and its gradient.
//!
//! `(1 - lambda) (Q - y)^2 + lambda (Q_imagined - y)^2`, with one target `y` for both: the n-step reward
//! and the target networks' value of the actions that the online network prefers (double Q-learning),
//! from what is really seen (dissertation equation 5.10).

use sortie_envs::{ActionSet, members};
use sortie_nn::random::Generator;

use super::agent::{AgentPass, AgentShape};
use super::looking::{Tensor, initialise};
use super::mixer::{MixerPass, MixerShape, Slopes, Teams};
use super::scenes::Scenes;
use super::split_attention::BLOCKS;
use crate::sized;

/// Sizes of agents and mixer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkShape {
    /// The agents' network.
    pub agent: AgentShape,
    /// The mixer.
    pub mixer: MixerShape,
}

impl NetworkShape {
    /// The tensors of both, the agents' first.
    pub fn tensors(self) -> Vec<Tensor> {
        let mut tensors = self.agent.tensors(0);
        tensors.extend(self.mixer.tensors(self.agent.parameters()));
        tensors
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        self.agent.parameters() + self.mixer.parameters()
    }
}

/// Agents and mixer: all parameters in one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// The sizes.
    pub shape: NetworkShape,
    /// The agents' parameters, then the mixer's.
    pub parameters: Vec<f32>,
}

impl Network {
    /// Draws all weights.
    pub fn initialise(shape: NetworkShape, generator: &mut Generator) -> Self {
        let mut parameters = vec![0.0; shape.parameters()];
        initialise(&shape.tensors(), &mut parameters, generator);
        Self { shape, parameters }
    }

    /// The agents' parameters.
    pub fn agent(&self) -> &[f32] {
        &self.parameters[..self.shape.agent.parameters()]
    }

    fn mixer(&self) -> &[f32] {
        &self.parameters[self.shape.agent.parameters()..]
    }
}

/// Records to learn from.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// The states in which the actions were taken.
    pub before: Scenes,
    /// The actions of all agents in them.
    pub actions: Vec<u16>,
    /// The discounted rewards until the states after.
    pub rewards: Vec<f32>,
    /// The states n steps later, or where the episode ended.
    pub after: Scenes,
    /// Instead of states after, in whole episodes: where among the states before each of them is followed;
    /// none for the last of an episode, in which nothing was done.
    pub next: Vec<Option<usize>>,
    /// What the value of the state after counts: the discount, or 0 where it is worth nothing.
    pub discounts: Vec<f32>,
}

impl Batch {
    /// Forgets all records, keeps the memory.
    pub fn clear(&mut self) {
        self.before.clear();
        self.actions.clear();
        self.rewards.clear();
        self.after.clear();
        self.next.clear();
        self.discounts.clear();
    }

    fn has_whole_episodes(&self) -> bool {
        !self.next.is_empty()
    }
}

/// Sums over a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Of the squared errors.
    pub real: f64,
    /// Of the squared errors of imagined values.
    pub imagined: f64,
    /// Of the targets.
    pub targets: f64,
}

/// Buffers of one worker.
#[derive(Clone, Debug, Default)]
pub struct TemporalDifference {
    agent: AgentPass,
    mixer: MixerPass,
    target_agent: AgentPass,
    target_mixer: MixerPass,
    preferred: Vec<usize>,
    chosen: Vec<f32>,
    /// Of every state in which something was done.
    targets: Vec<Option<f32>>,
    d_values: Vec<f32>,
    d_imagined: Vec<f32>,
    d_chosen: Vec<f32>,
    d_utilities: Vec<f32>,
}

/// The available action of the highest utility, the first of several.
pub(super) fn best(utilities: &[f32], available: ActionSet) -> usize {
    let mut best = available.trailing_zeros() as usize;
    for action in members(available.into()) {
        if utilities[action] > utilities[best] {
            best = action;
        }
    }
    best
}

impl TemporalDifference {
    /// The targets of a batch. Of whole episodes the online network's utilities are known.
    fn set_targets(&mut self, online: &Network, target: &Network, batch: &Batch) {
        let shape = online.shape.agent;
        let after = if batch.has_whole_episodes() { &batch.before } else { &batch.after };
        let preferred = if batch.has_whole_episodes() {
            self.agent.utilities(shape, after.agents())
        } else {
            self.target_agent.forward(shape, online.agent(), after, 1)
        };
        let agents = preferred.chunks_exact(shape.actions).zip(after.available());
        self.preferred.clear();
        self.preferred.extend(agents.map(|(utilities, open)| best(utilities, *open)));
        let utilities = self.target_agent.forward(shape, target.agent(), after, 1);
        self.chosen.clear();
        let rows = utilities.chunks_exact(shape.actions);
        self.chosen.extend(rows.zip(&self.preferred).map(|(row, action)| row[*action]));
        let (values, _) = self.target_mixer.forward(
            target.shape.mixer,
            target.mixer(),
            Teams { scenes: after, utilities: &self.chosen },
            1,
        );
        self.targets.clear();
        let records = batch.rewards.iter().zip(&batch.discounts).enumerate();
        self.targets.extend(records.map(|(record, (reward, discount))| {
            let next = match batch.next.get(record) {
                Some(next) => (*next)?,
                None => record,
            };
            Some(reward + discount * values[next])
        }));
    }

    /// The targets of the batch that was descended last, where something was done.
    pub fn targets(&self) -> &[Option<f32>] {
        &self.targets
    }

    /// Adds to `gradient` that of the mean loss over `records`, of which this batch is a part.
    ///
    /// `imagined` is lambda, or `None` where nothing is imagined.
    pub fn descend(
        &mut self,
        online: &Network,
        target: &Network,
        batch: &Batch,
        imagined: Option<f32>,
        records: usize,
        gradient: &mut [f32],
    ) -> Losses {
        let shape = online.shape;
        let blocks = if imagined.is_some() { BLOCKS } else { 1 };
        let agents = batch.before.agents();
        self.agent.forward(shape.agent, online.agent(), &batch.before, blocks);
        self.set_targets(online, target, batch);
        let utilities = self.agent.utilities(shape.agent, blocks * agents);
        self.chosen.clear();
        let rows = utilities.chunks_exact(shape.agent.actions);
        self.chosen
            .extend(rows.enumerate().map(|(row, utilities)| {
                utilities[usize::from(batch.actions[row % agents.max(1)])]
            }));
        let teams = Teams { scenes: &batch.before, utilities: &self.chosen };
        let (values, dreams) = self.mixer.forward(shape.mixer, online.mixer(), teams, blocks);
        let mut losses = Losses::default();
        let slopes = |values: &[f32], weight: f32, sum: &mut f64, out: &mut Vec<f32>| {
            out.clear();
            out.extend(values.iter().zip(&self.targets).map(|(value, target)| {
                let error = target.map_or(0.0, |target| value - target);
                *sum += f64::from(error * error);
                weight * 2.0 * error / records as f32
            }));
        };
        let lambda = imagined.unwrap_or(0.0);
        slopes(values, 1.0 - lambda, &mut losses.real, &mut self.d_values);
        slopes(dreams, lambda, &mut losses.imagined, &mut self.d_imagined);
        losses.targets = self.targets.iter().flatten().map(|target| f64::from(*target)).sum();

        let (d_agent, d_mixer) = gradient.split_at_mut(shape.agent.parameters());
        let d_chosen = sized(&mut self.d_chosen, self.chosen.len());
        let slopes = Slopes { values: &self.d_values, imagined: &self.d_imagined };
        self.mixer.backward(shape.mixer, online.mixer(), teams, slopes, d_chosen, d_mixer);
        let actions = shape.agent.actions;
        let d_utilities = sized(&mut self.d_utilities, self.chosen.len() * actions);
        d_utilities.fill(0.0);
        for (row, slope) in d_chosen.iter().enumerate() {
            let action = usize::from(batch.actions[row % agents.max(1)]);
            d_utilities[row * actions + action] = *slope;
        }
        self.agent.backward(shape.agent, online.agent(), &batch.before, d_utilities, d_agent);
        losses
    }
}
