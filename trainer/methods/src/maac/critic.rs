//! The critics: a value of each own action, from all observations and the others' actions.
//!
//! Dissertation section 3.3: every agent looks, with as many heads, at what the others observed and did, but not at
//! itself. Those of the methods that MAAC is compared with are [plainer](super::joint).

use std::ops::Range;

use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::joint::Joint;
use super::{CriticKind, CriticShape};
use crate::actor_critic::critic::{Critic, Shown, Values};
use crate::actor_critic::groups::{Groups, leaky};

/// Draws the first weights of a critic.
pub(super) fn critic(
    shape: CriticShape,
    groups: &Groups,
    random: &mut Generator,
) -> (Box<dyn Critic>, Parameters) {
    let mut parameters = Parameters::default();
    let critic: Box<dyn Critic> = match shape.kind {
        CriticKind::Attention | CriticKind::Uniform => {
            Box::new(Attentive::new(shape, groups, &mut parameters, random))
        }
        _ => Box::new(Joint::new(shape, groups, &mut parameters, random)),
    };
    (critic, parameters)
}

/// The layers of a critic that looks at the others.
#[derive(Clone, Debug)]
struct Attentive {
    groups: Groups,
    layers: Vec<GroupLayers>,
    heads: usize,
    /// Whether actions are normalised over the batch, as observations are.
    normalised: bool,
    /// Queries and keys; none where all others count the same, MAAC (Uniform).
    looks: Option<[Linear; 2]>,
    value: Linear,
    /// Weights that the values of all agents depend on, those of the others' encodings, which stand first.
    shared: [usize; 2],
}

#[derive(Clone, Copy, Debug)]
struct GroupLayers {
    /// Of an observation and an action, for keys and values.
    action_encoder: Linear,
    /// Of an observation, for the query and for itself.
    state_encoder: Linear,
    hidden: Linear,
    head: Linear,
}

impl Attentive {
    fn new(
        shape: CriticShape,
        groups: &Groups,
        p: &mut Parameters,
        random: &mut Generator,
    ) -> Self {
        let CriticShape { width, heads, normalised, .. } = shape;
        let named = |kind: &str, group: usize| format!("{kind}.{group}");
        let sized = || groups.0.iter().enumerate();
        let action_encoders: Vec<Linear> = sized()
            .map(|(index, group)| {
                let name = named("action_encoder", index);
                p.linear(&name, group.inputs() + group.actions, width, random)
            })
            .collect();
        let looks = (shape.kind == CriticKind::Attention)
            .then(|| ["query", "key"].map(|name| p.projection(name, width, width, random)));
        let value = p.linear("value", width, width, random);
        let shared = [p.values.len(), groups.agents()];
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
        let (groups, layers) = (groups.clone(), layers.collect());
        Self { groups, layers, heads, normalised, looks, value, shared }
    }
}

impl Critic for Attentive {
    fn shared(&self) -> [usize; 2] {
        self.shared
    }

    fn values(&self, pass: &mut Pass<'_>, shown: Shown<'_>, records: Range<usize>) -> Values {
        let groups = &self.groups;
        let (mut encoded, mut states) = (Vec::new(), Vec::new());
        for (index, (layers, group)) in self.layers.iter().zip(&groups.0).enumerate() {
            let seen = group.input(pass, &shown.observations[index], &records);
            let actions = &shown.actions[index];
            let mut taken = group.one_hot(&actions[group.range(&records)]);
            if self.normalised {
                group.moments(actions).normalise(&mut taken);
            }
            let taken = pass.input(group.actions, &taken);
            let both = pass.concat(&[seen, taken]);
            encoded.push(leaky(pass, both, layers.action_encoder));
            states.push(leaky(pass, seen, layers.state_encoder));
        }
        let encoded = pass.stack(&encoded);
        let values = leaky(pass, encoded, self.value);
        let (of_others, attended, squared_scores) = match self.looks {
            None => {
                let of_records = groups.records(records.len());
                (mean_of_others(pass, values, &of_records, groups.agents()), None, None)
            }
            Some([query, key]) => {
                let all = pass.stack(&states);
                let queries = pass.linear(all, query);
                let keys = pass.linear(encoded, key);
                let keys_values = pass.concat(&[keys, values]);
                let others = groups.others(records.len());
                let seen = pass.attention(queries, keys_values, &others, self.heads);
                let scores = || pass.squared_scores(queries, keys_values, &others, self.heads);
                (seen, Some(seen), shown.learns.then(scores))
            }
        };
        let all = self.layers.iter().zip(&groups.0).zip(states);
        let of_actions = all.map(|((layers, group), state)| {
            let others = pass.rows(of_others, group.places(records.len()));
            let both = pass.concat(&[state, others]);
            let hidden = leaky(pass, both, layers.hidden);
            pass.linear(hidden, layers.head).into()
        });
        let of_actions = of_actions.collect();
        Values { of_actions, attended, squared_scores, ..Values::default() }
    }
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

    use super::*;
    use crate::actor_critic::groups::{Group, Rows};

    /// Two agents that share and one alone, and what they see in two records.
    fn three() -> (Groups, Rows) {
        let group =
            |agents: Range<usize>| Group { agents, observed: 3, identity: false, actions: 2 };
        let seen =
            |rows: usize, first: f32| (0..rows * 3).map(|x| (first + x as f32).sin()).collect();
        (Groups(vec![group(0..2), group(2..3)]), vec![seen(4, 0.0), seen(2, 50.0)])
    }

    /// The values of each agent's actions in two records, after these actions.
    fn values(kind: CriticKind, actions: [u32; 6]) -> Vec<Vec<f32>> {
        let (groups, observations) = three();
        let shape = CriticShape { kind, width: 8, heads: 2, sees_own: false, normalised: false };
        let (critic, weights) = critic(shape, &groups, &mut stream(1, 1, 0));
        let actions = [actions[..4].to_vec(), actions[4..].to_vec()];
        let (observations, own) = (&observations, &Rows::new());
        let shown = Shown { observations, states: &[], actions: &actions, own, learns: false };
        let mut tape = Tape::default();
        let mut pass = tape.begin(&weights.values);
        let values = critic.values(&mut pass, shown, 0..2);
        let rows = values.of_actions.iter().flat_map(|of| pass.values(of.earned).chunks_exact(2));
        rows.map(<[f32]>::to_vec).collect()
    }

    /// The sum of all values of own actions that lie between, and its slopes by them.
    fn relaxed(kind: CriticKind, own: &Rows) -> (f32, Rows) {
        let (groups, observations) = three();
        let shape = CriticShape { kind, width: 8, heads: 2, sees_own: true, normalised: false };
        let (critic, weights) = critic(shape, &groups, &mut stream(1, 1, 0));
        let actions = [vec![1, 0, 1, 1], vec![0, 1]];
        let observations = &observations;
        let shown = Shown { observations, states: &[], actions: &actions, own, learns: false };
        let mut tape = Tape::default();
        let mut pass = tape.begin(&weights.values);
        let values = critic.values(&mut pass, shown, 0..2);
        let all: Vec<Var> = values.of_actions.iter().map(|of| of.earned).collect();
        let all = pass.stack(&all);
        assert_eq!(pass.size(all), [6, 1]);
        let sum = pass.sum_rows(all);
        pass.backward(sum, &mut vec![0.0; weights.values.len()]);
        let slopes = values.own_actions.iter().map(|own| pass.slopes(*own).unwrap().to_vec());
        (pass.values(sum)[0], slopes.collect())
    }

    #[test]
    fn the_slopes_by_own_actions_are_those_of_differences() {
        for kind in [CriticKind::All, CriticKind::Own] {
            let own = vec![vec![0.3, 0.7, 0.9, 0.1, 0.5, 0.5, 0.2, 0.8], vec![0.6, 0.4, 0.0, 1.0]];
            let (_, slopes) = relaxed(kind, &own);
            for (group, number) in [(0, 0), (0, 3), (0, 6), (1, 1), (1, 2)] {
                let at = |offset: f32| {
                    let mut moved = own.clone();
                    moved[group][number] += offset;
                    relaxed(kind, &moved).0
                };
                let (slope, want) = (slopes[group][number], (at(1e-2) - at(-1e-2)) / 2e-2);
                assert!(slope.abs() > 1e-4 && (slope - want).abs() < 1e-3, "{slope} {want}");
            }
        }
    }

    /// So that the mean over all own actions is a baseline.
    #[test]
    fn values_depend_on_what_the_others_did_in_the_same_record_alone() {
        use CriticKind::{All, Attention, One, Own, Uniform};
        for kind in [Attention, Uniform, All, One, Own] {
            let before = values(kind, [0; 6]);
            // The first agent of the first record does something else.
            let after = values(kind, [1, 0, 0, 0, 0, 0]);
            let changed: Vec<bool> = before.iter().zip(&after).map(|(a, b)| a != b).collect();
            let others = kind != Own;
            assert_eq!(changed, [false, others, false, false, others, false], "{kind:?}");
        }
    }

    #[test]
    fn others_that_all_count_the_same_come_to_their_mean() {
        let (groups, _) = three();
        let mut tape = Tape::default();
        let mut pass = tape.begin(&[]);
        // The first two agents in one record and in another, then the third in both.
        let x = pass.input(1, &[1., 2., 10., 20., 4., 40.]);
        let mean = mean_of_others(&mut pass, x, &groups.records(2), groups.agents());
        assert_eq!(pass.values(mean), [3., 2.5, 30., 25., 1.5, 15.]);
    }
}
