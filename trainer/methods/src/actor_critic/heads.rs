//! Soft actor-critics with several heads (dissertation section 4.4): each head has policies of its own, and values of the
//! team's reward and of a reward that only this head is paid. All learn from what any of them did.

use std::ops::Range;

use sortie_envs::Random;
use sortie_learn::run::UpdateReport;
use sortie_learn::{LearnError, State};
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::layers::softmax;
use sortie_nn::optimise::{Adam, clip_norm, move_towards};
use sortie_nn::random::Generator;
use sortie_nn::tape::{Chunks, Linear, Parameters, Pass, Var};

use super::acting::{Policies, PolicyShape};
use super::batch::Batch;
use super::groups::{Draw, Groups, Rows};
use super::losses::{Following, Step, added, drawn_loss};

/// Sizes of a critic.
#[derive(Clone, Debug, PartialEq)]
pub struct HeadCriticShape {
    /// Numbers of a state.
    pub state: usize,
    /// Width of its layers.
    pub width: usize,
    /// By heads: whether they are paid a reward of their own.
    pub paid: Vec<bool>,
}

/// A critic's layers and weights.
#[derive(Clone, Debug)]
pub struct HeadCritic {
    /// The weights, those of the encoder of states first.
    pub parameters: Parameters,
    encoder: Linear,
    /// By agents and heads.
    valuers: Vec<Valuer>,
    paid: Vec<bool>,
}

/// The layers of an agent with one of its heads.
#[derive(Clone, Copy, Debug)]
struct Valuer {
    /// Of the team's reward.
    team: Layers,
    /// Of the head's own.
    own: Option<Layers>,
}

/// The first layer is in two parts, of the state and of what the others do.
#[derive(Clone, Copy, Debug)]
struct Layers {
    first: [Linear; 2],
    last: Linear,
}

/// Values in some records, by agents and heads.
struct HeadValues {
    /// `[records, actions]`: of the team's reward.
    team: Var,
    /// `[records, actions]`: of the head's own, if it is paid one.
    own: Option<Var>,
}

impl HeadCritic {
    /// Draws the first weights.
    pub fn new(shape: &HeadCriticShape, groups: &Groups, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let width = shape.width;
        let encoder = parameters.linear("encoder", shape.state, width, random);
        let all: usize = groups.0.iter().map(|group| group.actions).sum();
        let mut valuers = Vec::new();
        for (agent, group) in groups.0.iter().enumerate() {
            for (head, is_paid) in shape.paid.iter().enumerate() {
                let mut layers = |kind: &str| {
                    let name = |part: &str| format!("{kind}.{head}.{agent}.{part}");
                    let inputs = [width, all - group.actions];
                    // The parts are drawn as one layer is.
                    let bound = 1.0 / ((inputs[0] + inputs[1]) as f32).sqrt();
                    let mut part = |what: &str, shape: &[usize]| {
                        parameters.tensor(&name(what), shape, bound, random)
                    };
                    let weights = [
                        part("state.weight", &[width, inputs[0]]),
                        part("others.weight", &[width, inputs[1]]),
                    ];
                    let biases = [Some(part("state.bias", &[width])), None];
                    let first = std::array::from_fn(|part| Linear {
                        shape: LinearShape { input: inputs[part], output: width },
                        weight: weights[part],
                        bias: biases[part],
                    });
                    let last = parameters.linear(&name("last"), width, group.actions, random);
                    Layers { first, last }
                };
                valuers.push(Valuer { team: layers("team"), own: is_paid.then(|| layers("own")) });
            }
        }
        Self { parameters, encoder, valuers, paid: shape.paid.clone() }
    }

    /// Numbers of a state.
    pub fn state(&self) -> usize {
        self.encoder.shape.input
    }

    /// Where the weights stand that all values depend on.
    pub fn shared(&self) -> Range<usize> {
        0..(self.encoder.shape.input + 1) * self.encoder.shape.output
    }

    /// By heads: whether they are paid a reward of their own.
    fn paid(&self) -> &[bool] {
        &self.paid
    }

    /// How many values there are, of all agents and heads.
    fn count(&self) -> usize {
        self.valuers.iter().map(|valuer| 1 + usize::from(valuer.own.is_some())).sum()
    }

    /// The values of some records in `states [records, state]`; `taken` says by agents and heads what agents do.
    fn values(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        states: &[f32],
        taken: &[Vec<u32>],
        records: Range<usize>,
    ) -> Vec<HeadValues> {
        let columns = self.encoder.shape.input;
        let state = pass.input(columns, &states[records.start * columns..records.end * columns]);
        let state = pass.linear_rectified(state, self.encoder);
        let heads = self.paid.len();
        let mut context = Vec::new();
        let valuers = self.valuers.iter().enumerate().map(|(index, valuer)| {
            let (agent, head) = (index / heads, index % heads);
            others(
                groups,
                agent,
                |other| &taken[other * heads + head][records.clone()],
                &mut context,
            );
            let others = pass.input(context.len() / records.len(), &context);
            let mut value = |Layers { first, last }| {
                let hidden = pass.linear_sum_rectified([state, others], first);
                pass.linear(hidden, last)
            };
            HeadValues { team: value(valuer.team), own: valuer.own.map(value) }
        });
        valuers.collect()
    }
}

/// Writes `[records, columns]` what the others of an agent do: a one for each of their actions, among zeros.
fn others<'a>(
    groups: &Groups,
    agent: usize,
    taken: impl Fn(usize) -> &'a [u32],
    context: &mut Vec<f32>,
) {
    let others = || groups.0.iter().enumerate().filter(|(other, _)| *other != agent);
    let columns: usize = others().map(|(_, group)| group.actions).sum();
    context.clear();
    context.resize(taken(agent).len() * columns, 0.0);
    let mut first = 0;
    for (other, group) in others() {
        for (row, action) in context.chunks_exact_mut(columns).zip(taken(other)) {
            row[first + *action as usize] = 1.0;
        }
        first += group.actions;
    }
}

/// Rows that are computed at once: a critic of many heads has more weights than records.
const ROWS: usize = 256;

/// How networks learn.
#[derive(Clone, Debug)]
pub struct HeadRules {
    /// Discounts of the team's rewards and of heads' own.
    pub discounts: [f32; 2],
    /// How much chance in the choice of actions is worth.
    pub entropy: f32,
    /// What a head's own values count beside the team's.
    pub own_weight: f32,
    /// What the mean squared score of an action counts.
    pub score_penalty: f32,
    /// How critic and policies move.
    pub(crate) steps: [Step; 2],
    /// Largest norms of the gradients of the critic and of an agent's policy.
    pub clips: [f32; 2],
    /// Share of the way that targets move in an update.
    pub target_rate: f32,
}

/// What an update sees.
#[derive(Clone, Debug, Default)]
pub struct HeadBatch {
    /// What agents saw, did and earned together; discounts are 1, and 0 behind an end.
    pub records: Batch,
    /// `[records, state]`: the states, and those that followed.
    pub states: [Vec<f32>; 2],
    /// By agents and heads, `[records]`: what heads are paid besides; empty of heads that are paid nothing.
    pub own: Rows,
}

/// Networks and optimisers.
#[derive(Debug)]
pub struct HeadLearner {
    rules: HeadRules,
    /// The agents, each a group of its own.
    pub groups: Groups,
    /// The same, once for each head.
    each: Groups,
    /// The critic that learns.
    pub critic: HeadCritic,
    /// The weights of the critic that targets are computed by.
    pub target_critic: Vec<f32>,
    /// The policies that learn, and act.
    pub policies: Policies,
    /// The weights of the policies that targets are computed by.
    pub target_policies: Vec<f32>,
    critic_optimiser: Adam,
    policy_optimiser: Adam,
    /// The critic's gradient of the last update, as its optimiser saw it but for the decay of weights.
    pub critic_gradient: Vec<f32>,
    /// The policies' gradient of the last update, as their optimiser saw it.
    pub policy_gradient: Vec<f32>,
    threads: usize,
    chunks: Chunks,
    space: Space,
}

/// Memory of updates, by agents and heads.
#[derive(Debug, Default)]
struct Space {
    scores: Rows,
    values: Rows,
    targets: Rows,
}

impl HeadLearner {
    /// Draws the first weights.
    pub fn new(
        rules: HeadRules,
        (policies, critic): (PolicyShape, &HeadCriticShape),
        groups: Groups,
        threads: usize,
        random: &mut Random,
    ) -> Self {
        let critic = HeadCritic::new(critic, &groups, random);
        let policies = Policies::new(policies, &groups, random);
        let each = groups.0.iter().flat_map(|group| vec![group.clone(); policies.heads()]);
        let [critic_step, policy_step] = rules.steps;
        let adam = |weights: &[f32], step: Step| Adam::new(weights.len(), step.epsilon);
        Self {
            target_critic: critic.parameters.values.clone(),
            target_policies: policies.parameters.values.clone(),
            critic_optimiser: adam(&critic.parameters.values, critic_step),
            policy_optimiser: adam(&policies.parameters.values, policy_step),
            critic_gradient: Vec::new(),
            policy_gradient: Vec::new(),
            chunks: Chunks::of_rows(ROWS),
            space: Space::default(),
            each: Groups(each.collect()),
            threads,
            critic,
            policies,
            groups,
            rules,
        }
    }

    /// One update of critic, policies and targets.
    pub fn update(&mut self, batch: &HeadBatch, draw: &mut dyn Draw) -> UpdateReport {
        self.find_targets(batch, draw);
        let report = self.update_critic(batch);
        self.update_policies(batch, draw);
        let rate = self.rules.target_rate;
        move_towards(&mut self.target_critic, &self.critic.parameters.values, rate);
        move_towards(&mut self.target_policies, &self.policies.parameters.values, rate);
        report
    }

    /// What the records are worth to each agent and head, of both rewards: what was earned, and the target critic's
    /// values of actions that each head's target policies draw. As in the public code the worth of chance is part of
    /// both, neither discounted nor lost behind an end.
    fn find_targets(&mut self, batch: &HeadBatch, draw: &mut dyn Draw) {
        let Self { rules, groups, each, critic, policies, threads, chunks, space, .. } = self;
        let (records, count) = (&batch.records, batch.records.records);
        let of = &self.target_policies;
        chunks.values(*threads, of, count, &mut space.scores, |pass, range| {
            policies.scores(pass, groups, &records.next, range)
        });
        let actions = draw.draw(each, &space.scores);
        let of = &self.target_critic;
        chunks.values(*threads, of, count, &mut space.values, |pass, range| {
            let values = critic.values(pass, groups, &batch.states[1], &actions, range.clone());
            let pairs = values.iter().zip(&actions);
            let both = pairs.flat_map(|(values, actions)| {
                let own = values.own.into_iter();
                [values.team]
                    .into_iter()
                    .chain(own)
                    .map(|of| pass.pick(of, &actions[range.clone()]))
                    .collect::<Vec<_>>()
            });
            both.collect()
        });
        space.targets.clear();
        let mut values = space.values.iter();
        let heads = critic.paid().len();
        for (index, (actions, scores)) in actions.iter().zip(&mut space.scores).enumerate() {
            let columns = each.0[index].actions;
            let agent = index / heads;
            let chances: Vec<f32> = scores
                .chunks_exact_mut(columns)
                .zip(actions)
                .map(|(scores, action)| {
                    softmax::log_forward(scores);
                    rules.entropy * scores[*action as usize]
                })
                .collect();
            let is_paid = critic.paid()[index % heads];
            let own = is_paid.then_some((&batch.own[index], rules.discounts[1]));
            let team = (&records.rewards[agent], rules.discounts[0]);
            for (rewards, discount) in [team].into_iter().chain(own) {
                let worth = values.next().into_iter().flatten().zip(&records.discounts[agent]);
                let targets = rewards.iter().zip(worth).zip(&chances);
                space.targets.push(
                    targets
                        .map(|((reward, (worth, goes_on)), chance)| {
                            reward + discount * goes_on * worth - chance
                        })
                        .collect(),
                );
            }
        }
    }

    /// Moves the critic towards the targets.
    fn update_critic(&mut self, batch: &HeadBatch) -> UpdateReport {
        let Self { rules, groups, critic, threads, chunks, space, .. } = self;
        let records = &batch.records;
        let share = 1.0 / records.records as f32;
        let gradient = &mut self.critic_gradient;
        gradient.clear();
        gradient.resize(critic.parameters.values.len(), 0.0);
        let heads = critic.paid().len();
        // What was done was done under one head, and counts for all.
        let taken = records.actions.iter().flat_map(|actions| vec![actions.clone(); heads]);
        let taken: Vec<Vec<u32>> = taken.collect();
        let of = &critic.parameters.values;
        let targets = &space.targets;
        let loss = chunks.gradient(*threads, of, records.records, gradient, |pass, range| {
            let values = critic.values(pass, groups, &batch.states[0], &taken, range.clone());
            let mut targets = targets.iter().map(|targets| &targets[range.clone()]);
            let mut loss = None;
            for (values, taken) in values.iter().zip(&taken) {
                let taken = &taken[range.clone()];
                let team = pass.pick(values.team, taken);
                let error = pass.squared_error(team, targets.next().unwrap_or_default(), share);
                loss = Some(added(pass, loss, error));
                if let Some(own) = values.own {
                    let own = pass.pick(own, taken);
                    let error = pass.huber(own, targets.next().unwrap_or_default(), share, 1.0);
                    loss = Some(added(pass, loss, error));
                }
            }
            loss.expect("there are agents")
        });
        // What serves all values is not to move as many times as far.
        let each = 1.0 / critic.count() as f32;
        gradient[critic.shared()].iter_mut().for_each(|slope| *slope *= each);
        let gradient_norm = clip_norm(gradient, rules.clips[0]);
        let weights = &mut critic.parameters.values;
        rules.steps[0].take(&mut self.critic_optimiser, weights, gradient);
        UpdateReport { loss, gradient_norm }
    }

    /// Moves the policies of each head towards what the critic values where all draw their actions by that head.
    fn update_policies(&mut self, batch: &HeadBatch, draw: &mut dyn Draw) {
        let Self { rules, groups, each, critic, policies, chunks, space, .. } = self;
        let (records, threads, count) = (&batch.records, self.threads, batch.records.records);
        let of = &policies.parameters.values;
        chunks.values(threads, of, count, &mut space.scores, |pass, range| {
            policies.scores(pass, groups, &records.observations, range)
        });
        let actions = draw.draw(each, &space.scores);
        let of = &critic.parameters.values;
        chunks.values(threads, of, count, &mut space.values, |pass, range| {
            let values = critic.values(pass, groups, &batch.states[0], &actions, range);
            let whole = values.iter().map(|values| match values.own {
                Some(own) => {
                    let own = pass.scale(own, rules.own_weight);
                    pass.add(values.team, own)
                }
                None => values.team,
            });
            whole.collect()
        });
        let gradient = &mut self.policy_gradient;
        let (values, entropy) = (&space.values, rules.entropy);
        let score_penalty = rules.score_penalty;
        let following = Following { policies, groups, score_penalty, threads, chunks };
        following.gradient(records, gradient, |pass, index, scores, rows| {
            let columns = each.0[index].actions;
            let values = &values[index][rows.start * columns..rows.end * columns];
            drawn_loss(pass, scores, values, &actions[index][rows], entropy)
        });
        let share = 1.0 / policies.heads() as f32;
        for range in policies.shared() {
            gradient[range].iter_mut().for_each(|slope| *slope *= share);
        }
        for range in policies.ranges() {
            clip_norm(&mut gradient[range], rules.clips[1]);
        }
        let weights = &mut policies.parameters.values;
        rules.steps[1].take(&mut self.policy_optimiser, weights, gradient);
    }

    /// Names what the rest of a run depends on.
    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let Self { critic, policies, critic_optimiser, policy_optimiser, .. } = self;
        let tensors = critic.parameters.tensors().to_vec();
        for (name, vector) in [
            ("critic", &mut critic.parameters.values),
            ("target-critic", &mut self.target_critic),
            ("critic-adam-mean", &mut critic_optimiser.mean),
            ("critic-adam-square", &mut critic_optimiser.square),
        ] {
            state.tensors(name, &tensors, vector)?;
        }
        let tensors = policies.parameters.tensors().to_vec();
        for (name, vector) in [
            ("policies", &mut policies.parameters.values),
            ("target-policies", &mut self.target_policies),
            ("policy-adam-mean", &mut policy_optimiser.mean),
            ("policy-adam-square", &mut policy_optimiser.square),
        ] {
            state.tensors(name, &tensors, vector)?;
        }
        state.value("critic-adam-steps", &mut critic_optimiser.steps)?;
        state.value("policy-adam-steps", &mut policy_optimiser.steps)
    }
}
