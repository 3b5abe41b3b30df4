//! The critic: for each agent and head a value of each own action, from the state and what the others do.

use std::ops::Range;

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use crate::actor_critic::groups::Groups;

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
pub(super) struct HeadValues {
    /// `[records, actions]`: of the team's reward.
    pub(super) team: Var,
    /// `[records, actions]`: of the head's own, if it is paid one.
    pub(super) own: Option<Var>,
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
    pub(super) fn paid(&self) -> &[bool] {
        &self.paid
    }

    /// How many values there are, of all agents and heads.
    pub(super) fn count(&self) -> usize {
        self.valuers.iter().map(|valuer| 1 + usize::from(valuer.own.is_some())).sum()
    }

    /// The values of some records in `states [records, state]`; `taken` says by agents and heads what agents do.
    pub(super) fn values(
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
