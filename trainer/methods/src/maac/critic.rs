//! The attentive critic: a value of each own action, from all observations and the others' actions.
//!
//! Dissertation section 3.3: every agent looks, with as many heads, at what the others observed and did, but not at
//! itself.

use std::ops::Range;

use sortie_nn::layers::VisibleLists;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::groups::Groups;

/// Slope of leaky ReLU below zero.
pub(super) const SLOPE: f32 = 0.01;

/// Sizes of a critic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CriticShape {
    /// Width of its layers.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Whether all others count the same, MAAC (Uniform).
    pub uniform: bool,
}

/// A critic's layers and weights.
#[derive(Clone, Debug)]
pub struct Critic {
    shape: CriticShape,
    /// The weights of all groups; those that the values of others depend on come [first](Self::shared).
    pub parameters: Parameters,
    groups: Vec<GroupLayers>,
    /// Queries and keys.
    looks: Option<[Linear; 2]>,
    value: Linear,
    shared: usize,
}

/// The layers of a group's agents.
#[derive(Clone, Copy, Debug)]
struct GroupLayers {
    /// Of an observation and an action, for keys and values.
    action_encoder: Linear,
    /// Of an observation, for the query and for itself.
    state_encoder: Linear,
    hidden: Linear,
    head: Linear,
}

/// What a critic is shown, by groups: rows of records.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// `[rows, inputs]`
    pub observations: &'a [Vec<f32>],
    /// `[rows, inputs + actions]`: the same, and which action was taken.
    pub encoded: &'a [Vec<f32>],
}

/// Who stands in the rows of so many records.
#[derive(Debug, Default)]
pub struct Order {
    pub(super) others: VisibleLists,
    pub(super) records: Vec<u32>,
}

/// What a critic says.
#[derive(Debug)]
pub struct Values {
    /// By groups, `[rows, actions]`: the value of each own action.
    pub of_actions: Vec<Var>,
    /// `[rows, 1]`: the squared scores of attention; none where all count the same.
    pub squared_scores: Option<Var>,
}

impl Critic {
    /// Draws the first weights.
    pub fn new(shape: CriticShape, groups: &Groups, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let CriticShape { width, uniform, .. } = shape;
        let named = |kind: &str, group: usize| format!("{kind}.{group}");
        let p = &mut parameters;
        let sized = || groups.0.iter().enumerate();
        let action_encoders: Vec<Linear> = sized()
            .map(|(index, group)| {
                let name = named("action_encoder", index);
                p.linear(&name, group.inputs() + group.actions, width, random)
            })
            .collect();
        let looks = (!uniform)
            .then(|| ["query", "key"].map(|name| p.projection(name, width, width, random)));
        let value = p.linear("value", width, width, random);
        let shared = p.values.len();
        let layers = sized().zip(action_encoders).map(|((index, group), action_encoder)| {
            let mut linear =
                |kind: &str, input, output| p.linear(&named(kind, index), input, output, random);
            GroupLayers {
                action_encoder,
                state_encoder: linear("state_encoder", group.inputs(), width),
                hidden: linear("hidden", 2 * width, width),
                head: linear("head", width, group.actions),
            }
        });
        let groups = layers.collect();
        Self { shape, groups, looks, value, shared, parameters }
    }

    /// Where the weights stand whose gradients come from the values of all agents.
    pub fn shared(&self) -> Range<usize> {
        0..self.shared
    }

    /// The values of some records.
    pub fn values(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        shown: Shown<'_>,
        records: Range<usize>,
        order: &Order,
    ) -> Values {
        let agents = groups.agents();
        let encode = |pass: &mut Pass<'_>, group: usize, numbers: &[f32], layer: Linear| {
            let row = layer.shape.input;
            let of_record = row * groups.0[group].agents.len();
            let numbers = &numbers[records.start * of_record..records.end * of_record];
            let x = pass.input(row, numbers);
            leaky(pass, x, layer)
        };
        let layers = || self.groups.iter().enumerate();
        let encoded: Vec<Var> = layers()
            .map(|(index, layers)| {
                encode(pass, index, &shown.encoded[index], layers.action_encoder)
            })
            .collect();
        let states: Vec<Var> = layers()
            .map(|(index, layers)| {
                encode(pass, index, &shown.observations[index], layers.state_encoder)
            })
            .collect();
        let encoded = pass.stack(&encoded);
        let values = leaky(pass, encoded, self.value);
        let (of_others, squared_scores) = match self.looks {
            None => (mean_of_others(pass, values, &order.records, agents), None),
            Some([query, key]) => {
                let all = pass.stack(&states);
                let queries = pass.linear(all, query);
                let keys = pass.linear(encoded, key);
                let keys_values = pass.concat(&[keys, values]);
                let heads = self.shape.heads;
                let seen = pass.attention(queries, keys_values, &order.others, heads);
                let scores = pass.squared_scores(queries, keys_values, &order.others, heads);
                (seen, Some(scores))
            }
        };
        let of_actions = layers().zip(states).map(|((index, layers), state)| {
            let agents = &groups.0[index].agents;
            let rows = agents.start * records.len()..agents.end * records.len();
            let others = pass.rows(of_others, rows);
            let both = pass.concat(&[state, others]);
            let hidden = leaky(pass, both, layers.hidden);
            pass.linear(hidden, layers.head)
        });
        Values { of_actions: of_actions.collect(), squared_scores }
    }
}

/// A layer with leaky ReLU behind it.
pub(super) fn leaky(pass: &mut Pass<'_>, x: Var, layer: Linear) -> Var {
    let y = pass.linear(x, layer);
    pass.leaky_relu(y, SLOPE)
}

/// For every row the mean of the other rows of its record.
fn mean_of_others(pass: &mut Pass<'_>, x: Var, records: &[u32], agents: usize) -> Var {
    let count = records.len() / agents;
    let sums = pass.scatter(x, records, count);
    let sums = pass.gather(sums, records);
    let own = pass.scale(x, -1.0);
    let others = pass.add(sums, own);
    pass.scale(others, 1.0 / (agents - 1).max(1) as f32)
}

#[cfg(test)]
mod tests {
    use sortie_nn::random::stream;
    use sortie_nn::tape::Tape;

    use super::super::batch::encode;
    use super::super::groups::Group;
    use super::*;

    /// The values of each agent's actions in two records, after these actions.
    fn values(uniform: bool, actions: [u32; 6]) -> Vec<Vec<f32>> {
        let group =
            |agents: Range<usize>| Group { agents, observed: 3, identity: false, actions: 2 };
        let groups = Groups(vec![group(0..2), group(2..3)]);
        let shape = CriticShape { width: 8, heads: 2, uniform };
        let critic = Critic::new(shape, &groups, &mut stream(1, 1, 0));
        let seen =
            |rows: usize, first: f32| (0..rows * 3).map(|x| (first + x as f32).sin()).collect();
        let observations: Vec<Vec<f32>> = vec![seen(4, 0.0), seen(2, 50.0)];
        let actions = [actions[..4].to_vec(), actions[4..].to_vec()];
        let mut encoded = Vec::new();
        encode(&groups, &observations, &actions, false, &mut encoded);
        let mut order = Order::default();
        groups.others(2, &mut order.others);
        groups.records(2, &mut order.records);
        let mut tape = Tape::default();
        let mut pass = tape.begin(&critic.parameters.values);
        let shown = Shown { observations: &observations, encoded: &encoded };
        let values = critic.values(&mut pass, &groups, shown, 0..2, &order);
        let rows = values.of_actions.iter().flat_map(|of| pass.values(*of).chunks_exact(2));
        rows.map(<[f32]>::to_vec).collect()
    }

    /// So that the mean over all own actions is a baseline.
    #[test]
    fn values_depend_on_what_the_others_did_in_the_same_record_alone() {
        for uniform in [false, true] {
            let before = values(uniform, [0; 6]);
            // The first agent of the first record does something else.
            let after = values(uniform, [1, 0, 0, 0, 0, 0]);
            let changed: Vec<bool> = before.iter().zip(&after).map(|(a, b)| a != b).collect();
            assert_eq!(changed, [false, true, false, false, true, false], "uniform {uniform}");
        }
    }
}
