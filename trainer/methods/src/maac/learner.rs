//! An update: the critic learns from records, the policies from the critic (dissertation section 3.3).

use sortie_envs::Random;
use sortie_learn::run::UpdateReport;
use sortie_nn::layers::{normalise, softmax};
use sortie_nn::optimise::{Adam, clip_norm, move_towards};
use sortie_nn::tape::Chunks;

use super::critic::Critic;
use super::{Config, OwnActions, PolicyValues};
use crate::actor_critic::acting::Policies;
use crate::actor_critic::batch::Batch;
use crate::actor_critic::groups::{Draw, Encoded, Groups, Rows, Running, best_of_all};
use crate::actor_critic::losses::{
    Following, added, drawn_loss, expected_loss, relaxed_loss, soft_value,
};

/// Networks and optimisers.
#[derive(Debug)]
pub struct Learner {
    pub(super) config: Config,
    pub(super) groups: Groups,
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
    threads: usize,
    chunks: Chunks,
    encoded: Encoded,
    space: Space,
}

/// Memory of updates.
#[derive(Debug, Default)]
struct Space {
    scores: Rows,
    next_values: Rows,
    targets: Rows,
    /// Of own actions, or the slopes by them of what the critic was shown.
    values: Rows,
    noise: Rows,
}

impl Learner {
    /// Draws the first weights.
    pub fn new(config: Config, groups: Groups, threads: usize, random: &mut Random) -> Self {
        let critic = Critic::new(config.critic_shape(), &groups, random);
        let policies = Policies::new(config.policy_shape(), &groups, random);
        let adam = |parameters: &[f32]| Adam::new(parameters.len(), config.optimiser.epsilon);
        Self {
            target_critic: critic.parameters.values.clone(),
            target_policies: policies.parameters.values.clone(),
            average_policies: policies.parameters.values.clone(),
            running: Running::new(&groups),
            critic_optimiser: adam(&critic.parameters.values),
            policy_optimiser: adam(&policies.parameters.values),
            critic_gradient: Vec::new(),
            policy_gradient: Vec::new(),
            chunks: Chunks::default(),
            threads,
            encoded: Encoded::default(),
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
        self.find_targets(batch, entropy, draw);
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

    /// What the records are worth: rewards, and the target critic's values of what comes next.
    fn find_targets(&mut self, batch: &Batch, entropy: f32, draw: &mut dyn Draw) {
        let Self { groups, critic, policies, threads, chunks, encoded, space, config, .. } = self;
        let of = &self.target_policies;
        chunks.values(*threads, of, batch.records, &mut space.scores, |pass, range| {
            policies.scores(pass, groups, &batch.next, range)
        });
        let rule = config.update.own_actions;
        let actions = match rule {
            OwnActions::Relaxed => best_of_all(groups, &space.scores),
            _ => draw.draw(groups, &space.scores),
        };
        let taken = [&actions, &actions];
        let shown = critic.encode(groups, &batch.next, taken, config.network.normalised, encoded);
        let of = &self.target_critic;
        chunks.values(*threads, of, batch.records, &mut space.next_values, |pass, range| {
            critic.values(pass, groups, shown, range).of_actions
        });
        space.targets.resize_with(groups.0.len(), Vec::new);
        for (index, group) in groups.0.iter().enumerate() {
            let targets = &mut space.targets[index];
            targets.clear();
            targets.resize(batch.rewards[index].len(), 0.0);
            let values = &space.next_values[index];
            let values = values.chunks_exact(values.len() / targets.len());
            let scores = space.scores[index].chunks_exact_mut(group.actions);
            for (row, (values, scores)) in values.zip(scores).enumerate().rev() {
                softmax::log_forward(scores);
                let (reward, discount) = (batch.rewards[index][row], batch.discounts[index][row]);
                let (mut worth, chance) = match rule {
                    OwnActions::Expected => (soft_value(values, scores, entropy), 0.0),
                    OwnActions::Drawn => {
                        let action = actions[index][row] as usize;
                        (values[action], entropy * scores[action])
                    }
                    OwnActions::Relaxed => (values[0], 0.0),
                };
                let agents = group.agents.len();
                if batch.follows.get(row / agents) == Some(&true) {
                    worth += config.returns.lambda * (targets[row + agents] - worth);
                }
                // As in the public code the worth of chance is neither discounted nor lost behind an end.
                targets[row] = reward + discount * worth - chance;
            }
        }
    }

    /// Moves the critic towards the targets, and keeps its values.
    fn update_critic(&mut self, batch: &Batch) -> UpdateReport {
        let Self { groups, critic, threads, chunks, encoded, space, config, .. } = self;
        let (seen, taken) = (&batch.observations, [&batch.actions; 2]);
        let shown = critic.encode(groups, seen, taken, config.network.normalised, encoded);
        let (agents, share) = (groups.agents(), 1.0 / batch.records as f32);
        let penalty = config.update.attention_penalty * share / (agents - 1).max(1) as f32;
        let gradient = &mut self.critic_gradient;
        gradient.clear();
        gradient.resize(critic.parameters.values.len(), 0.0);
        let of = &critic.parameters.values;
        let keep = (&mut gradient[..], &mut space.values);
        let targets = &space.targets;
        let loss = chunks.gradient_and_values(*threads, of, batch.records, keep, |pass, range| {
            let values = critic.values(pass, groups, shown, range.clone());
            let mut loss = values.squared_scores.map(|scores| {
                let sum = pass.sum_rows(scores);
                pass.scale(sum, penalty)
            });
            for (index, of_actions) in values.of_actions.iter().enumerate() {
                let size = groups.0[index].agents.len();
                let rows = range.start * size..range.end * size;
                let chosen = if pass.size(*of_actions)[1] == 1 {
                    *of_actions
                } else {
                    pass.pick(*of_actions, &batch.actions[index][rows.clone()])
                };
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
        settings.step(settings.critic_rate, settings.weight_decay).take(adam, weights, gradient);
        UpdateReport { loss, gradient_norm }
    }

    /// Moves the policies towards what the critic values.
    fn update_policies(&mut self, batch: &Batch, entropy: f32, draw: &mut dyn Draw) {
        let rule = &self.config.update;
        let anew =
            rule.own_actions == OwnActions::Relaxed || rule.policy_values == PolicyValues::Fresh;
        let actions = anew.then(|| self.value_anew(batch, draw));
        let actions = actions.as_ref().unwrap_or(&batch.actions);
        let Self { groups, policies, chunks, space, config, .. } = self;
        let (threads, rule) = (self.threads, &config.update);
        let gradient = &mut self.policy_gradient;
        let Space { values, noise, .. } = space;
        let score_penalty = rule.score_penalty;
        let following = Following { policies, groups, score_penalty, threads, chunks };
        following.gradient(batch, gradient, |pass, index, scores, rows| {
            let columns = groups.0[index].actions;
            let numbers = rows.start * columns..rows.end * columns;
            let values = &values[index][numbers.clone()];
            match rule.own_actions {
                OwnActions::Expected => expected_loss(pass, scores, values, entropy),
                OwnActions::Drawn => {
                    drawn_loss(pass, scores, values, &actions[index][rows], entropy)
                }
                OwnActions::Relaxed => relaxed_loss(pass, scores, &noise[index][numbers], values),
            }
        });
        let settings = &config.optimiser;
        for range in policies.ranges() {
            clip_norm(&mut gradient[range], settings.policy_clip);
        }
        let adam = &mut self.policy_optimiser;
        let weights = &mut policies.parameters.values;
        settings.step(settings.policy_rate, 0.0).take(adam, weights, gradient);
    }

    /// Has all agents act as they would now, and finds the updated critic's values of that. Returns the actions.
    ///
    /// A critic that sees the own action is shown a drawn one, while the others do their best, and its slopes are found.
    fn value_anew(&mut self, batch: &Batch, draw: &mut dyn Draw) -> Vec<Vec<u32>> {
        let Self { groups, critic, policies, threads, chunks, encoded, space, config, .. } = self;
        let Space { scores, values, noise, .. } = space;
        let of = &policies.parameters.values;
        chunks.values(*threads, of, batch.records, scores, |pass, range| {
            policies.scores(pass, groups, &batch.observations, range)
        });
        let relaxed = config.update.own_actions == OwnActions::Relaxed;
        let others = if relaxed { best_of_all(groups, scores) } else { draw.draw(groups, scores) };
        let own = relaxed.then(|| {
            noise.resize_with(scores.len(), Vec::new);
            for (scores, noise) in scores.iter_mut().zip(noise) {
                noise.clear();
                noise.resize(scores.len(), 0.0);
                draw.shake(noise);
                scores.iter_mut().zip(noise).for_each(|(score, noise)| *score += *noise);
            }
            best_of_all(groups, scores)
        });
        let (seen, taken) = (&batch.observations, [&others, own.as_ref().unwrap_or(&others)]);
        let shown = critic.encode(groups, seen, taken, config.network.normalised, encoded);
        let of = &critic.parameters.values;
        if !relaxed {
            chunks.values(*threads, of, batch.records, values, |pass, range| {
                critic.values(pass, groups, shown, range).of_actions
            });
            return others;
        }
        chunks.slopes(*threads, of, batch.records, values, |pass, range| {
            let values = critic.values(pass, groups, shown, range);
            let sums = values.of_actions.iter().map(|values| pass.sum_rows(*values));
            let sums: Vec<_> = sums.collect();
            let sum = pass.stack(&sums);
            let sum = pass.sum_rows(sum);
            (pass.scale(sum, -1.0), values.own)
        });
        others
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;

    use super::*;
    use crate::actor_critic::groups::Group;
    use crate::maac::CriticKind;

    const RECORDS: usize = 6;

    /// Two episodes of two agents, of four decisions and of two; the first ends for good.
    fn episodes(rewards: bool) -> Batch {
        let numbers = |first: f32, count: usize| -> Vec<f32> {
            (0..count).map(|x| (first + x as f32).sin()).collect()
        };
        let ends = [1.0, 1.0, 1.0, 0.0, 1.0, 1.0];
        let discounts = ends.iter().flat_map(|goes_on| [0.9 * goes_on; 2]).collect();
        Batch {
            records: RECORDS,
            observations: vec![numbers(1.0, RECORDS * 2 * 3)],
            actions: vec![(0..RECORDS as u32 * 2).map(|x| x % 2).collect()],
            rewards: vec![if rewards { numbers(7.0, RECORDS * 2) } else { vec![0.0; 12] }],
            discounts: vec![if rewards { discounts } else { vec![1.0; 12] }],
            next: vec![numbers(4.0, RECORDS * 2 * 3)],
            follows: vec![true, true, true, false, true],
        }
    }

    fn targets(lambda: f32, batch: &Batch) -> Vec<f32> {
        let mut config = Config::default();
        config.network.critic = CriticKind::One;
        config.returns.lambda = lambda;
        let groups = Groups(vec![Group { agents: 0..2, observed: 3, identity: false, actions: 2 }]);
        let mut learner = Learner::new(config, groups, 1, &mut generator(1));
        learner.find_targets(batch, 0.0, &mut generator(2));
        learner.space.targets[0].clone()
    }

    /// Against the forward view: returns of so many decisions each, mixed by powers of lambda.
    #[test]
    fn targets_of_whole_episodes_mix_returns_of_all_lengths() {
        let lambda = 0.8;
        let batch = episodes(true);
        let found = targets(lambda, &batch);
        let worth = targets(0.0, &episodes(false));
        for (agent, (first, last)) in [(0, 4), (4, 6)].into_iter().flat_map(|e| [(0, e), (1, e)]) {
            for start in first..last {
                let row = |record: usize| record * 2 + agent;
                let (mut earned, mut discount, mut want, mut rest) = (0.0, 1.0, 0.0, 1.0);
                for record in start..last {
                    earned += discount * batch.rewards[0][row(record)];
                    discount *= batch.discounts[0][row(record)];
                    let share = if record + 1 == last { rest } else { rest * (1.0 - lambda) };
                    want += share * (earned + discount * worth[row(record)]);
                    rest *= lambda;
                }
                let found = found[row(start)];
                assert!((found - want).abs() < 1e-5, "{agent} {start}: {found} {want}");
            }
        }
    }
}
