//! An update: a critic learns from records, policies from the critic (dissertation sections 3.3 and 4.4).
//!
//! Policies may have several heads, each with values of its own, and besides with values of a reward that only this head is
//! paid. All learn from what any of them did.

use std::ops::Range;

use sortie_learn::learner::{self, By, Loss, Shard};
use sortie_learn::run::UpdateReport;
use sortie_learn::{LearnError, State};
use sortie_nn::layers::{normalise, softmax};
use sortie_nn::optimise::{AdamRules, clip_norm};
use sortie_nn::tape::{Parameters, Pass, Var};

use super::critic::{Batch, Critic, Shown, Values};
use super::groups::{Draw, Groups, Rows, Running, best_of_all, emptied};
use super::losses::{drawn_loss, expected_loss, relaxed_loss, soft_value, sum, whole};
use super::policies::Policies;
use super::{OwnActions, PolicyValues, Rules};

/// Networks and optimisers.
#[derive(Debug)]
pub struct ActorCritic {
    rules: Rules,
    /// The agents.
    pub groups: Groups,
    /// The same, once for each head.
    each: Groups,
    /// The critic's layers.
    pub critic: Box<dyn Critic>,
    /// Its weights.
    pub critic_learner: learner::Learner<Rows>,
    /// The policies' layers.
    pub policies: Policies,
    /// Their weights.
    pub policy_learner: learner::Learner<Rows>,
    /// What the policies were shown, where that is normalised.
    pub running: Option<Running>,
    scores: Rows,
    /// By groups and heads: of what is earned, and of what is paid.
    targets: [Rows; 2],
    /// Gumbel's noise in the choice of own actions.
    noise: Rows,
}

/// Keeps what a pass has computed.
fn keep(pass: &Pass<'_>, found: &mut Rows, vars: impl ExactSizeIterator<Item = Var>) {
    emptied(found, vars.len());
    vars.zip(found).for_each(|(var, found)| found.extend_from_slice(pass.values(var)));
}

/// What so many shards have found, matrix by matrix, one behind the other.
fn join(learner: &learner::Learner<Rows>, shards: usize, joined: &mut Rows) {
    let count = learner.spaces().next().map_or(0, Vec::len);
    emptied(joined, count);
    for found in learner.spaces().take(shards) {
        joined.iter_mut().zip(found).for_each(|(joined, found)| joined.extend_from_slice(found));
    }
}

impl ActorCritic {
    /// Learns with these networks.
    pub fn new(
        rules: Rules,
        groups: Groups,
        (critic, critic_weights): (Box<dyn Critic>, Parameters),
        (policies, policy_weights): (Policies, Parameters),
        normalised: bool,
        threads: usize,
    ) -> Self {
        let each = groups.0.iter().flat_map(|group| vec![group.clone(); policies.heads]);
        let [target_rate, average_rate] = rules.follow;
        let adam = AdamRules { decay: 0.0, ..rules.adam };
        let of_policies =
            learner::Rules { adam, target_rate, average_rate, ..learner::Rules::default() };
        let of_critic = learner::Rules { adam: rules.adam, average_rate: 1.0, ..of_policies };
        Self {
            each: Groups(each.collect()),
            critic_learner: learner::Learner::new(critic_weights, of_critic, threads),
            policy_learner: learner::Learner::new(policy_weights, of_policies, threads),
            running: normalised.then(|| Running::new(&groups)),
            scores: Rows::new(),
            targets: Default::default(),
            noise: Rows::new(),
            critic,
            policies,
            groups,
            rules,
        }
    }

    /// How many groups there are, and how many of groups and heads.
    pub(crate) fn sizes(&self) -> [usize; 2] {
        [self.groups.0.len(), self.each.0.len()]
    }

    /// One update of critic, policies and targets, where chance in the choice of actions is worth so much; normalises what the
    /// batch shows, if that is wanted.
    pub fn update(&mut self, batch: &mut Batch, entropy: f32, draw: &mut dyn Draw) -> UpdateReport {
        self.normalise(batch);
        self.find_targets(batch, entropy, draw);
        let report = self.update_critic(batch);
        self.update_policies(batch, entropy, draw);
        report
    }

    fn normalise(&mut self, batch: &mut Batch) {
        let Some(running) = &mut self.running else { return };
        for (index, group) in self.groups.0.iter().enumerate() {
            let observations = &mut batch.observations[index];
            let rows = observations.len() / group.inputs();
            let moments = normalise::batch(group.inputs(), observations);
            running.update(index, &moments, rows);
            normalise::batch(group.inputs(), &mut batch.next[index]);
        }
    }

    /// The records of each shard of a batch.
    fn shards(&self, batch: &Batch) -> Vec<Range<usize>> {
        let (size, records) = (self.rules.shard, batch.records);
        (0..records).step_by(size).map(|first| first..records.min(first + size)).collect()
    }

    /// Finds the scores of actions where agents are shown these rows, by the policies that learn or by their targets.
    fn score(&mut self, shards: &[Range<usize>], shown: &Rows, by: By) {
        let Self { groups, policies, policy_learner, scores, .. } = self;
        policy_learner.look(shards.len(), by, |Shard { number, pass, space, .. }| {
            let (heads, records) = (0..policies.heads, shards[*number].clone());
            let scores = policies.scores(pass, groups, shown, heads, records);
            keep(pass, space, scores.into_iter());
        });
        join(policy_learner, shards.len(), scores);
    }

    /// What the records are worth: rewards, and the target critic's values of what comes next.
    fn find_targets(&mut self, batch: &Batch, entropy: f32, draw: &mut dyn Draw) {
        let shards = self.shards(batch);
        self.score(&shards, &batch.next, By::Target);
        let Self { rules, each, critic, critic_learner, .. } = self;
        let actions = match rules.own_actions {
            OwnActions::Relaxed => best_of_all(each, &self.scores),
            _ => draw.draw(each, &self.scores),
        };
        let own = rules.own_rows(each, &actions);
        let (observations, states) = (&batch.next, &batch.states[1][..]);
        let shown = Shown { observations, states, actions: &actions, own: &own, learns: false };
        critic_learner.look(shards.len(), By::Target, |Shard { number, pass, space, .. }| {
            let values = critic.values(pass, shown, shards[*number].clone()).of_actions;
            let all = values.iter().flat_map(|of| std::iter::once(of.earned).chain(of.paid));
            keep(pass, space, all.collect::<Vec<_>>().into_iter());
        });
        let mut values = Rows::new();
        join(critic_learner, shards.len(), &mut values);
        self.look_back(batch, entropy, &actions, &values);
    }

    /// Computes targets from what comes next, the last first: scores of actions, those that all take, and the values of all
    /// that is earned and paid.
    fn look_back(&mut self, batch: &Batch, entropy: f32, actions: &[Vec<u32>], values: &Rows) {
        let Self { rules, each, .. } = self;
        let mut values = values.iter();
        self.targets.iter_mut().for_each(|targets| emptied(targets, each.0.len()));
        for (index, scores) in self.scores.iter_mut().enumerate() {
            let (of, columns) = (index / self.policies.heads, each.0[index].actions);
            scores.chunks_exact_mut(columns).for_each(softmax::log_forward);
            let (rule, actions) = (rules.own_actions, &actions[index]);
            let choices = Choices { rule, entropy, columns, logarithms: scores, actions };
            let paid = batch.paid.get(index).map_or(&[][..], Vec::as_slice);
            let kinds = [(&batch.rewards[of][..], None), (paid, Some(rules.paid_discount))];
            for ((rewards, discount), targets) in kinds.into_iter().zip(&mut self.targets) {
                if rewards.is_empty() {
                    continue;
                }
                let values = values.next().expect("values of all that is earned");
                let (agents, targets) = (each.0[index].agents.len(), &mut targets[index]);
                targets.resize(rewards.len(), 0.0);
                for row in (0..rewards.len()).rev() {
                    let [mut worth, chance] = choices.worth(values, row);
                    if batch.follows.get(row / agents) == Some(&true) {
                        worth += rules.lambda * (targets[row + agents] - worth);
                    }
                    let own = batch.discounts[of][row];
                    let discount = discount.filter(|_| own > 0.0).unwrap_or(own);
                    // As in the public code the worth of chance is neither discounted nor lost behind an end.
                    targets[row] = rewards[row] + discount * worth - chance;
                }
            }
        }
    }

    /// Moves the critic towards the targets. Its shards keep the values that it had.
    fn update_critic(&mut self, batch: &Batch) -> UpdateReport {
        let (shards, heads) = (self.shards(batch), self.policies.heads);
        let Self { rules, groups, each, critic, critic_learner, .. } = self;
        // What was done was done under one head, and counts for all.
        let taken = batch.actions.iter().flat_map(|actions| vec![actions.clone(); heads]);
        let taken: Vec<Vec<u32>> = taken.collect();
        let own = rules.own_rows(each, &taken);
        let (observations, states) = (&batch.observations, &batch.states[0][..]);
        let shown = Shown { observations, states, actions: &taken, own: &own, learns: true };
        let share = 1.0 / batch.records as f32;
        let penalty = rules.penalties[0] * share / (groups.agents() - 1).max(1) as f32;
        let [earned, paid] = &self.targets;
        let loss = |shard: &mut Shard<'_, Rows>| {
            let records = shards[shard.number].clone();
            let Shard { pass, space, .. } = shard;
            let values = critic.values(pass, shown, records.clone());
            let mut terms = Vec::new();
            if let Some(scores) = values.squared_scores {
                let sum = pass.sum_rows(scores);
                terms.push(pass.scale(sum, penalty));
            }
            for (index, of) in values.of_actions.iter().enumerate() {
                let rows = each.0[index].range(&records);
                let chosen = |pass: &mut Pass<'_>, values: Var| match pass.size(values) {
                    [_, 1] => values,
                    _ => pass.pick(values, &taken[index][rows.clone()]),
                };
                let value = chosen(pass, of.earned);
                terms.push(pass.squared_error(value, &earned[index][rows.clone()], share));
                if let Some(value) = of.paid {
                    let value = chosen(pass, value);
                    terms.push(pass.huber(value, &paid[index][rows.clone()], share, 1.0));
                }
            }
            keep(pass, space, values.of_actions.iter().map(|of| of.earned));
            Loss::of(pass, |pass| whole(pass, terms))
        };
        let ([weights, served], clip) = (critic.shared(), rules.clips[0]);
        critic_learner.update_by(shards.len(), rules.rates[0], loss, |gradient| {
            // What serves several values is not to move as many times as far.
            gradient[..weights].iter_mut().for_each(|slope| *slope *= 1.0 / served as f32);
            clip_norm(gradient, clip)
        })
    }

    /// Moves the policies towards what the critic values.
    fn update_policies(&mut self, batch: &Batch, entropy: f32, draw: &mut dyn Draw) {
        let (shards, rule) = (self.shards(batch), self.rules.own_actions);
        let is_fresh =
            rule == OwnActions::Relaxed || self.rules.policy_values == PolicyValues::Fresh;
        let drawn = is_fresh.then(|| self.value_anew(batch, draw));
        let actions = drawn.as_ref().unwrap_or(&batch.actions);
        let Self { rules, groups, each, critic_learner, policies, noise, .. } = self;
        let values: Vec<&Rows> = critic_learner.spaces().collect();
        let share = 1.0 / batch.records as f32;
        let loss = |Shard { number, pass, .. }: &mut Shard<'_, Rows>| {
            let (heads, records) = (0..policies.heads, shards[*number].clone());
            let scores = policies.scores(pass, groups, &batch.observations, heads, records.clone());
            let mut terms = Vec::new();
            for (index, scores) in scores.into_iter().enumerate() {
                let (group, values) = (&each.0[index], &values[*number][index]);
                let rows = group.range(&records);
                let gain = match rule {
                    OwnActions::Expected => expected_loss(pass, scores, values, entropy),
                    OwnActions::Drawn => {
                        drawn_loss(pass, scores, values, &actions[index][rows], entropy)
                    }
                    OwnActions::Relaxed => {
                        let noise = group.rows(&noise[index], group.actions, &records);
                        relaxed_loss(pass, scores, noise, values)
                    }
                };
                terms.push(pass.scale(gain, share));
                let squares = pass.multiply(scores, scores);
                let squares = sum(pass, squares);
                let penalty = rules.penalties[1] * share / group.actions as f32;
                terms.push(pass.scale(squares, penalty));
            }
            Loss::of(pass, |pass| whole(pass, terms))
        };
        let (each_head, clip) = (1.0 / policies.heads as f32, rules.clips[1]);
        self.policy_learner.update_by(shards.len(), rules.rates[1], loss, |gradient| {
            policies.ranges().fold(0.0, |longest: f32, (range, shared)| {
                let gradient = &mut gradient[range];
                gradient[..shared].iter_mut().for_each(|slope| *slope *= each_head);
                longest.max(clip_norm(gradient, clip))
            })
        });
    }

    /// Has all agents act as they would now, and the updated critic's shards keep the values of that. Returns the actions.
    ///
    /// A critic that sees the own action is shown a drawn one, while the others do their best, and its shards keep slopes.
    fn value_anew(&mut self, batch: &Batch, draw: &mut dyn Draw) -> Vec<Vec<u32>> {
        let shards = self.shards(batch);
        self.score(&shards, &batch.observations, By::Online);
        let Self { rules, each, critic, critic_learner, scores, noise, .. } = self;
        let relaxed = rules.own_actions == OwnActions::Relaxed;
        let others = if relaxed { best_of_all(each, scores) } else { draw.draw(each, scores) };
        let mut own = Rows::new();
        if relaxed {
            emptied(noise, scores.len());
            for (scores, noise) in scores.iter_mut().zip(noise) {
                noise.resize(scores.len(), 0.0);
                draw.shake(noise);
                scores.iter_mut().zip(noise).for_each(|(score, noise)| *score += *noise);
            }
            own = rules.own_rows(each, &best_of_all(each, scores));
        }
        let (observations, states) = (&batch.observations, &batch.states[0][..]);
        let shown = Shown { observations, states, actions: &others, own: &own, learns: false };
        let weights = critic_learner.online.values.len();
        critic_learner.look(shards.len(), By::Online, |Shard { number, pass, space, .. }| {
            let values = critic.values(pass, shown, shards[*number].clone());
            if relaxed {
                keep_slopes(pass, &values, weights, space);
            } else {
                keep_values(pass, &values, rules.paid_weight, space);
            }
        });
        others
    }

    /// Names what the rest of a run depends on.
    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        for (learner, name, adam) in [
            (&mut self.critic_learner, "critic", "critic"),
            (&mut self.policy_learner, "policies", "policy"),
        ] {
            learner.state_as(state, |part| match part {
                "online" => name.to_owned(),
                "target" | "average" => format!("{part}-{name}"),
                _ => format!("{adam}-{part}"),
            })?;
        }
        self.running.as_mut().map_or(Ok(()), |running| running.state(state))
    }
}

/// Actions that all chose, and how.
struct Choices<'a> {
    rule: OwnActions,
    entropy: f32,
    columns: usize,
    /// `[rows, columns]`: of the chances of actions.
    logarithms: &'a [f32],
    /// `[rows]`
    actions: &'a [u32],
}

impl Choices<'_> {
    /// What a row's state is worth where its actions are worth so much, and what the chance in its action is.
    fn worth(&self, values: &[f32], row: usize) -> [f32; 2] {
        let own = row * self.columns..(row + 1) * self.columns;
        match self.rule {
            OwnActions::Expected => {
                [soft_value(&values[own.clone()], &self.logarithms[own], self.entropy), 0.0]
            }
            OwnActions::Drawn => {
                let action = own.start + self.actions[row] as usize;
                [values[action], self.entropy * self.logarithms[action]]
            }
            OwnActions::Relaxed => [values[row], 0.0],
        }
    }
}

/// Keeps what actions are worth to each head, what it is paid included.
fn keep_values(pass: &mut Pass<'_>, values: &Values, weight: f32, found: &mut Rows) {
    let of = values.of_actions.iter().map(|of| match of.paid {
        Some(paid) => {
            let paid = pass.scale(paid, weight);
            pass.add(of.earned, paid)
        }
        None => of.earned,
    });
    let whole: Vec<Var> = of.collect();
    keep(pass, found, whole.into_iter());
}

/// Keeps the slopes of a cost, minus all values, by the own actions that the critic sees.
fn keep_slopes(pass: &mut Pass<'_>, values: &Values, weights: usize, found: &mut Rows) {
    let sums: Vec<Var> = values.of_actions.iter().map(|of| pass.sum_rows(of.earned)).collect();
    let sum = pass.stack(&sums);
    let sum = pass.sum_rows(sum);
    let cost = pass.scale(sum, -1.0);
    pass.backward(cost, &mut vec![0.0; weights]);
    emptied(found, values.own_actions.len());
    for (own, found) in values.own_actions.iter().zip(found) {
        found.extend_from_slice(pass.slopes(*own).unwrap_or_default());
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::random::generator;
    use sortie_nn::tape::Linear;

    use super::*;
    use crate::actor_critic::critic::Value;
    use crate::actor_critic::groups::Group;
    use crate::actor_critic::policies::PolicyShape;

    const RECORDS: usize = 6;

    /// A layer that sees an agent's own row.
    #[derive(Debug)]
    struct Plain(Linear, Group);

    impl Critic for Plain {
        fn shared(&self) -> [usize; 2] {
            [0, 1]
        }

        fn values(&self, pass: &mut Pass<'_>, shown: Shown<'_>, records: Range<usize>) -> Values {
            let x = pass.input(3, self.1.rows(&shown.observations[0], 3, &records));
            let paid = shown.states.first().map(|_| pass.linear(x, self.0));
            let of_actions = vec![Value { earned: pass.linear(x, self.0), paid }];
            Values { of_actions, ..Values::default() }
        }
    }

    fn numbers(first: f32, count: usize) -> Vec<f32> {
        (0..count).map(|x| (first + x as f32).sin()).collect()
    }

    /// Two episodes of two agents, of four decisions and of two; the first ends for good.
    fn episodes(rewards: bool) -> Batch {
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
            ..Batch::default()
        }
    }

    fn targets(lambda: f32, batch: &Batch) -> [Rows; 2] {
        let groups = Groups(vec![Group { agents: 0..2, observed: 3, identity: false, actions: 2 }]);
        let rules = Rules {
            own_actions: OwnActions::Expected,
            policy_values: PolicyValues::Kept,
            lambda,
            paid_discount: 0.5,
            paid_weight: 1.0,
            penalties: [0.0; 2],
            rates: [0.1; 2],
            adam: AdamRules::default(),
            clips: [1.0; 2],
            follow: [1.0; 2],
            shard: 4,
        };
        let (mut weights, random) = (Parameters::default(), &mut generator(1));
        let critic = Plain(weights.linear("values", 3, 2, random), groups.0[0].clone());
        let shape = PolicyShape { widths: [4, 4], heads: 1, slope: 0.0 };
        let policies = Policies::new(shape, &groups, random);
        let critic = (Box::new(critic) as Box<dyn Critic>, weights);
        let mut learner = ActorCritic::new(rules, groups, critic, policies, false, 1);
        learner.find_targets(batch, 0.0, &mut generator(2));
        learner.targets
    }

    /// Against the forward view: returns of so many decisions each, mixed by powers of lambda.
    #[test]
    fn targets_of_whole_episodes_mix_returns_of_all_lengths() {
        let lambda = 0.8;
        let batch = episodes(true);
        let [found, _] = targets(lambda, &batch);
        let [worth, _] = targets(0.0, &episodes(false));
        for (agent, (first, last)) in [(0, 4), (4, 6)].into_iter().flat_map(|e| [(0, e), (1, e)]) {
            for start in first..last {
                let row = |record: usize| record * 2 + agent;
                let (mut earned, mut discount, mut want, mut rest) = (0.0, 1.0, 0.0, 1.0);
                for record in start..last {
                    earned += discount * batch.rewards[0][row(record)];
                    discount *= batch.discounts[0][row(record)];
                    let share = if record + 1 == last { rest } else { rest * (1.0 - lambda) };
                    want += share * (earned + discount * worth[0][row(record)]);
                    rest *= lambda;
                }
                let found = found[0][row(start)];
                assert!((found - want).abs() < 1e-5, "{agent} {start}: {found} {want}");
            }
        }
    }

    #[test]
    fn what_heads_are_paid_has_a_discount_of_its_own_and_ends_with_the_episode() {
        let [worth, _] = targets(0.0, &episodes(false));
        let mut batch = episodes(true);
        (batch.states, batch.paid) = ([vec![1.0], vec![1.0]], vec![numbers(2.0, RECORDS * 2)]);
        let [_, paid] = targets(0.0, &batch);
        for (row, paid) in paid[0].iter().enumerate() {
            let discount = if batch.discounts[0][row] > 0.0 { 0.5 } else { 0.0 };
            let want = batch.paid[0][row] + discount * worth[0][row];
            assert!((paid - want).abs() < 1e-6, "{row}: {paid} {want}");
        }
    }
}
