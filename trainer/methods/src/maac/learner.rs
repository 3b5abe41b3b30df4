//! An update: the critic learns from records, the policies from the critic (dissertation section 3.3).

use sortie_envs::Random;
use sortie_learn::run::UpdateReport;
use sortie_nn::layers::{normalise, softmax};
use sortie_nn::optimise::{Adam, clip_norm, move_towards};

use super::batch::{Batch, Running, encode};
use super::config::{Attention, Config, OwnActions, PolicyValues};
use super::critic::{Critic, CriticShape, Shown};
use super::drawing::Draw;
use super::groups::{Groups, Rows};
use super::lanes::Lanes;
use super::losses::{added, drawn_loss, expected_loss, soft_value, sum};
use super::policies::Policies;

/// Networks and optimisers.
#[derive(Debug)]
pub struct Learner {
    pub(super) config: Config,
    pub(super) groups: Groups,
    threads: usize,
    /// The critic that learns.
    pub critic: Critic,
    /// The weights of the critic that targets are computed by.
    pub target_critic: Vec<f32>,
    /// The policies that learn, and act.
    pub policies: Policies,
    /// The weights of the policies that targets are computed by.
    pub target_policies: Vec<f32>,
    /// The weights of the policies that are measured.
    pub average_policies: Vec<f32>,
    /// What the policies were shown.
    pub running: Running,
    pub(super) critic_optimiser: Adam,
    pub(super) policy_optimiser: Adam,
    /// The critic's gradient of the last update, as its optimiser saw it but for the decay of weights.
    pub critic_gradient: Vec<f32>,
    /// The policies' gradient of the last update, as their optimiser saw it.
    pub policy_gradient: Vec<f32>,
    lanes: Lanes,
    space: Space,
}

/// Memory of updates.
#[derive(Debug, Default)]
struct Space {
    encoded: Rows,
    next_encoded: Rows,
    next_scores: Rows,
    next_values: Rows,
    targets: Rows,
    values: Rows,
    scores: Rows,
    nothing: Rows,
}

impl Learner {
    /// Draws the first weights.
    pub fn new(config: Config, groups: Groups, threads: usize, random: &mut Random) -> Self {
        let network = &config.network;
        let uniform = network.attention == Attention::Uniform;
        let shape = CriticShape { width: network.critic_width, heads: network.heads, uniform };
        let critic = Critic::new(shape, &groups, random);
        let policies = Policies::new(network.policy_width, &groups, random);
        let adam = |parameters: &[f32]| Adam::new(parameters.len(), config.optimiser.epsilon);
        Self {
            threads,
            target_critic: critic.parameters.values.clone(),
            target_policies: policies.parameters.values.clone(),
            average_policies: policies.parameters.values.clone(),
            running: Running::new(&groups),
            critic_optimiser: adam(&critic.parameters.values),
            policy_optimiser: adam(&policies.parameters.values),
            critic_gradient: Vec::new(),
            policy_gradient: Vec::new(),
            lanes: Lanes::default(),
            space: Space::default(),
            critic,
            policies,
            groups,
            config,
        }
    }

    /// One update of critic, policies and targets; normalises what the batch shows, if that is wanted.
    pub fn update(&mut self, batch: &mut Batch, entropy: f32, draw: &mut dyn Draw) -> UpdateReport {
        self.normalise(batch);
        let next_actions = self.target_actions(batch, draw);
        self.find_targets(batch, &next_actions, entropy);
        let report = self.update_critic(batch);
        self.update_policies(batch, entropy, draw);
        let rate = self.config.optimiser.target_rate;
        move_towards(&mut self.target_critic, &self.critic.parameters.values, rate);
        move_towards(&mut self.target_policies, &self.policies.parameters.values, rate);
        let rate = self.config.optimiser.average_rate;
        if rate < 1.0 {
            move_towards(&mut self.average_policies, &self.policies.parameters.values, rate);
        } else {
            self.average_policies.copy_from_slice(&self.policies.parameters.values);
        }
        report
    }

    fn normalise(&mut self, batch: &mut Batch) {
        if !self.config.network.normalised {
            return;
        }
        for (index, group) in self.groups.0.iter().enumerate() {
            let observations = &mut batch.observations[index];
            let rows = observations.len() / group.inputs();
            let moments = normalise::batch(group.inputs(), observations);
            self.running.update(index, &moments, rows);
            normalise::batch(group.inputs(), &mut batch.next[index]);
        }
    }

    /// What the target policies do next.
    fn target_actions(&mut self, batch: &Batch, draw: &mut dyn Draw) -> Vec<Vec<u32>> {
        let Self { groups, policies, lanes, space, target_policies, threads, .. } = self;
        let of = (&target_policies[..], batch.records);
        lanes.compute(*threads, of, groups, &mut space.next_scores, |pass, range, _| {
            policies.scores(pass, groups, &batch.next, range)
        });
        draw.draw(groups, &space.next_scores)
    }

    /// What the records are worth: rewards, and the target critic's values of what comes next.
    fn find_targets(&mut self, batch: &Batch, next_actions: &[Vec<u32>], entropy: f32) {
        let Self { groups, critic, lanes, space, target_critic, threads, config, .. } = self;
        let normalised = config.network.normalised;
        encode(groups, &batch.next, next_actions, normalised, &mut space.next_encoded);
        let shown = Shown { observations: &batch.next, encoded: &space.next_encoded };
        let of = (&target_critic[..], batch.records);
        lanes.compute(*threads, of, groups, &mut space.next_values, |pass, range, order| {
            critic.values(pass, groups, shown, range, order).of_actions
        });
        space.targets.resize_with(groups.0.len(), Vec::new);
        for (index, group) in groups.0.iter().enumerate() {
            let rows = space.next_values[index].chunks_exact(group.actions);
            let scores = space.next_scores[index].chunks_exact_mut(group.actions);
            let records = rows.zip(scores).enumerate();
            space.targets[index].clear();
            space.targets[index].extend(records.map(|(row, (values, scores))| {
                softmax::log_forward(scores);
                let (reward, discount) = (batch.rewards[index][row], batch.discounts[index][row]);
                match config.update.own_actions {
                    OwnActions::Expected => reward + discount * soft_value(values, scores, entropy),
                    OwnActions::Drawn => {
                        let action = next_actions[index][row] as usize;
                        // As in the public code the entropy is neither discounted nor lost behind an end.
                        reward + discount * values[action] - entropy * scores[action]
                    }
                }
            }));
        }
    }

    /// Moves the critic towards the targets, and keeps its values.
    fn update_critic(&mut self, batch: &Batch) -> UpdateReport {
        let Self { groups, critic, lanes, space, threads, config, .. } = self;
        let normalised = config.network.normalised;
        encode(groups, &batch.observations, &batch.actions, normalised, &mut space.encoded);
        let shown = Shown { observations: &batch.observations, encoded: &space.encoded };
        let (agents, share) = (groups.agents(), 1.0 / batch.records as f32);
        let penalty = config.update.attention_penalty * share / (agents - 1).max(1) as f32;
        let gradient = &mut self.critic_gradient;
        gradient.clear();
        gradient.resize(critic.parameters.values.len(), 0.0);
        let of = (&critic.parameters.values[..], batch.records);
        let keep = (&mut gradient[..], &mut space.values);
        let targets = &space.targets;
        let loss = lanes.descend(*threads, of, groups, keep, |pass, range, order| {
            let values = critic.values(pass, groups, shown, range.clone(), order);
            let mut loss = values.squared_scores.map(|scores| {
                let sum = pass.sum_rows(scores);
                pass.scale(sum, penalty)
            });
            for (index, of_actions) in values.of_actions.iter().enumerate() {
                let size = groups.0[index].agents.len();
                let rows = range.start * size..range.end * size;
                let chosen = pass.pick(*of_actions, &batch.actions[index][rows.clone()]);
                let error = pass.squared_error(chosen, &targets[index][rows], share);
                loss = Some(added(pass, loss, error));
            }
            (loss.expect("there are agents"), values.of_actions)
        });
        // What serves the values of all agents is not to move as many times as far.
        let each = 1.0 / agents as f32;
        gradient[critic.shared()].iter_mut().for_each(|slope| *slope *= each);
        let settings = &config.optimiser;
        let gradient_norm = clip_norm(gradient, settings.critic_clip * agents as f32);
        let adam = &mut self.critic_optimiser;
        let weights = &mut critic.parameters.values;
        follow(adam, weights, gradient, settings.critic_rate, settings.weight_decay, settings);
        UpdateReport { loss, gradient_norm }
    }

    /// Moves the policies towards what the critic values.
    fn update_policies(&mut self, batch: &Batch, entropy: f32, draw: &mut dyn Draw) {
        let actions = match self.config.update.policy_values {
            PolicyValues::Kept => Vec::new(),
            PolicyValues::Fresh => self.value_anew(batch, draw),
        };
        let Self { groups, policies, lanes, space, threads, config, .. } = self;
        let (share, rule) = (1.0 / batch.records as f32, &config.update);
        let gradient = &mut self.policy_gradient;
        gradient.clear();
        gradient.resize(policies.parameters.values.len(), 0.0);
        let of = (&policies.parameters.values[..], batch.records);
        let (values, keep) = (&space.values, (&mut gradient[..], &mut space.nothing));
        lanes.descend(*threads, of, groups, keep, |pass, range, _| {
            let all = policies.scores(pass, groups, &batch.observations, range.clone());
            let mut loss = None;
            for (index, scores) in all.into_iter().enumerate() {
                let group = &groups.0[index];
                let rows = range.start * group.agents.len()..range.end * group.agents.len();
                let numbers = rows.start * group.actions..rows.end * group.actions;
                let values = &values[index][numbers];
                let gain = match rule.own_actions {
                    OwnActions::Expected => expected_loss(pass, scores, values, entropy),
                    OwnActions::Drawn => {
                        drawn_loss(pass, scores, values, &actions[index][rows], entropy)
                    }
                };
                let gain = pass.scale(gain, share);
                loss = Some(added(pass, loss, gain));
                let squares = pass.multiply(scores, scores);
                let squares = sum(pass, squares);
                let penalty = rule.score_penalty * share / group.actions as f32;
                let squares = pass.scale(squares, penalty);
                loss = Some(added(pass, loss, squares));
            }
            (loss.expect("there are agents"), Vec::new())
        });
        let settings = &config.optimiser;
        for range in policies.ranges() {
            clip_norm(&mut gradient[range], settings.policy_clip);
        }
        let adam = &mut self.policy_optimiser;
        let weights = &mut policies.parameters.values;
        follow(adam, weights, gradient, settings.policy_rate, 0.0, settings);
    }

    /// Has all agents act as they would now, and finds the updated critic's values of that. Returns the actions.
    fn value_anew(&mut self, batch: &Batch, draw: &mut dyn Draw) -> Vec<Vec<u32>> {
        let Self { groups, critic, policies, lanes, space, threads, config, .. } = self;
        let of = (&policies.parameters.values[..], batch.records);
        lanes.compute(*threads, of, groups, &mut space.scores, |pass, range, _| {
            policies.scores(pass, groups, &batch.observations, range)
        });
        let actions = draw.draw(groups, &space.scores);
        let normalised = config.network.normalised;
        encode(groups, &batch.observations, &actions, normalised, &mut space.encoded);
        let shown = Shown { observations: &batch.observations, encoded: &space.encoded };
        let of = (&critic.parameters.values[..], batch.records);
        lanes.compute(*threads, of, groups, &mut space.values, |pass, range, order| {
            critic.values(pass, groups, shown, range, order).of_actions
        });
        actions
    }
}

/// Takes one step down a gradient.
fn follow(
    adam: &mut Adam,
    weights: &mut [f32],
    gradient: &[f32],
    rate: f32,
    decay: f32,
    settings: &super::config::OptimiserConfig,
) {
    if settings.early_epsilon {
        // Before the correction: what is added is corrected as well.
        let correction = 1.0 - 0.999_f64.powf((adam.steps + 1) as f64);
        adam.epsilon = (f64::from(settings.epsilon) / correction.sqrt()) as f32;
    }
    if decay == 0.0 {
        adam.step(&mut [weights], gradient, rate);
        return;
    }
    let decayed = gradient.iter().zip(&*weights).map(|(slope, weight)| slope + decay * weight);
    let decayed: Vec<f32> = decayed.collect();
    adam.step(&mut [weights], &decayed, rate);
}
