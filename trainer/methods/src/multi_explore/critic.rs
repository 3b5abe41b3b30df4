//! The critic: by agents and heads values of the team's reward, and of a reward that only this head is paid.

use std::ops::Range;

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass};

use crate::actor_critic::critic::{Critic, Shown, Value, Values};
use crate::actor_critic::groups::Groups;

/// A critic's layers; agents are each a group of their own.
#[derive(Clone, Debug)]
pub(super) struct HeadCritic {
    groups: Groups,
    encoder: Linear,
    /// By agents and heads: of the team's reward, and of the head's own.
    valuers: Vec<(Layers, Option<Layers>)>,
}

/// The first layer is in two parts, of the state and of what the others do.
#[derive(Clone, Copy, Debug)]
struct Layers {
    first: [Linear; 2],
    last: Linear,
}

impl HeadCritic {
    /// Draws the first weights of layers of such a width over so many numbers of a state; says which heads are paid a reward of
    /// their own.
    pub(super) fn new(
        [state, width]: [usize; 2],
        paid: &[bool],
        groups: &Groups,
        random: &mut Generator,
    ) -> (Self, Parameters) {
        let mut parameters = Parameters::default();
        let encoder = parameters.linear("encoder", state, width, random);
        let all: usize = groups.0.iter().map(|group| group.actions).sum();
        let mut valuers = Vec::new();
        for (agent, group) in groups.0.iter().enumerate() {
            for (head, is_paid) in paid.iter().enumerate() {
                let mut layers = |kind: &str| {
                    let name = |part: &str| format!("{kind}.{head}.{agent}.{part}");
                    let others = all - group.actions;
                    // The parts are drawn as one layer is.
                    let bound = 1.0 / ((width + others) as f32).sqrt();
                    let mut part = |part: &str, input: usize| {
                        let shape = LinearShape { input, output: width };
                        let weight = parameters.tensor(&name(part), &[width, input], bound, random);
                        Linear { shape, weight, bias: None }
                    };
                    let mut first = [part("state.weight", width), part("others.weight", others)];
                    let bias = parameters.tensor(&name("state.bias"), &[width], bound, random);
                    first[0].bias = Some(bias);
                    let last = parameters.linear(&name("last"), width, group.actions, random);
                    Layers { first, last }
                };
                valuers.push((layers("team"), is_paid.then(|| layers("own"))));
            }
        }
        (Self { groups: groups.clone(), encoder, valuers }, parameters)
    }
}

impl Critic for HeadCritic {
    /// The encoder of states.
    fn shared(&self) -> [usize; 2] {
        let LinearShape { input, output } = self.encoder.shape;
        let served = self.valuers.iter().map(|(_, own)| 1 + usize::from(own.is_some()));
        [(input + 1) * output, served.sum()]
    }

    fn values(&self, pass: &mut Pass<'_>, shown: Shown<'_>, records: Range<usize>) -> Values {
        let columns = self.encoder.shape.input;
        let states = &shown.states[records.start * columns..records.end * columns];
        let state = pass.input(columns, states);
        let state = pass.linear_rectified(state, self.encoder);
        let groups = &self.groups.0;
        let heads = self.valuers.len() / groups.len();
        let valuers = self.valuers.iter().enumerate().map(|(index, (team, own))| {
            let (agent, head) = (index / heads, index % heads);
            // A one for each action of the others, among zeros.
            let columns = team.first[1].shape.input;
            let (mut others, mut first) = (vec![0.0; records.len() * columns], 0);
            for (other, group) in groups.iter().enumerate().filter(|(other, _)| *other != agent) {
                let taken = &shown.actions[other * heads + head][records.clone()];
                for (row, action) in others.chunks_exact_mut(columns).zip(taken) {
                    row[first + *action as usize] = 1.0;
                }
                first += group.actions;
            }
            let others = pass.input(columns, &others);
            let mut value = |Layers { first, last }| {
                let hidden = pass.linear_sum_rectified([state, others], first);
                pass.linear(hidden, last)
            };
            Value { earned: value(*team), paid: own.map(value) }
        });
        Values { of_actions: valuers.collect(), ..Values::default() }
    }
}
