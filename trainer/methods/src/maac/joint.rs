//! Critics of plain layers, which the methods that MAAC is compared with have (dissertation table 3.1): everything in
//! one row, with a critic for each group of agents or one for all, or what an agent sees itself.

use std::ops::Range;

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::{CriticKind, CriticShape};
use crate::actor_critic::groups::{Groups, Rows, SLOPE, emptied, leaky};
use crate::actor_critic::learner::{Critic, Encoded, Shown, Values};

/// Such a critic's layers.
#[derive(Clone, Debug)]
pub(super) struct Joint {
    kind: CriticKind,
    /// By groups; one where all have the same.
    layers: Vec<Layers>,
}

/// The first layer is in parts, as an agent's row is what all observe, what the others do and which agent is asked.
#[derive(Clone, Copy, Debug)]
struct Layers {
    observed: Linear,
    context: Option<Linear>,
    /// Of the own action, where it is seen.
    own: Option<Linear>,
    hidden: Linear,
    head: Linear,
}

impl Joint {
    /// Draws the first weights.
    pub(super) fn new(
        shape: CriticShape,
        groups: &Groups,
        p: &mut Parameters,
        random: &mut Generator,
    ) -> Self {
        let CriticShape { kind, width, .. } = shape;
        let most = groups.0.iter().map(|group| group.actions).max().unwrap_or(0);
        let observed_by_all: usize =
            groups.0.iter().map(|group| group.inputs() * group.agents.len()).sum();
        let count = if kind == CriticKind::One { 1 } else { groups.0.len() };
        let layers = groups.0[..count].iter().enumerate().map(|(index, group)| {
            let actions = if kind == CriticKind::One { most } else { group.actions };
            let observed = if kind == CriticKind::Own { group.inputs() } else { observed_by_all };
            let context = context_columns(kind, groups, index);
            let own = if shape.sees_own { actions } else { 0 };
            // The parts are drawn as one layer is.
            let bound = 1.0 / ((observed + context + own) as f32).sqrt();
            let mut part = |name: &str, input: usize| {
                let name = format!("{name}.{index}.weight");
                let weight = p.tensor(&name, &[width, input], bound, random);
                Linear { shape: LinearShape { input, output: width }, weight, bias: None }
            };
            let mut observed = part("observed", observed);
            let context = (context > 0).then(|| part("context", context));
            let own = (own > 0).then(|| part("own", own));
            let name = format!("observed.{index}.bias");
            observed.bias = Some(p.tensor(&name, &[width], bound, random));
            let outputs = if shape.sees_own { 1 } else { actions };
            let hidden = p.linear(&format!("hidden.{index}"), width, width, random);
            let head = p.linear(&format!("head.{index}"), width, outputs, random);
            Layers { observed, context, own, hidden, head }
        });
        Self { kind, layers: layers.collect() }
    }
}

impl Critic for Joint {
    fn shared(&self) -> [usize; 2] {
        [0, 1]
    }

    /// For every row what the others of its record do, each in its place, and which agent it is about.
    fn encode(
        &self,
        groups: &Groups,
        _: &Rows,
        actions: [&[Vec<u32>]; 2],
        _: bool,
        encoded: &mut Encoded,
    ) {
        let [taken, own] = actions.map(|actions| -> Rows {
            groups.0.iter().zip(actions).map(|(group, taken)| group.one_hot(taken)).collect()
        });
        encoded.own = own;
        emptied(&mut encoded.taken, groups.0.len());
        if self.kind == CriticKind::Own {
            return;
        }
        for (index, (group, encoded)) in groups.0.iter().zip(&mut encoded.taken).enumerate() {
            let columns = context_columns(self.kind, groups, index);
            let records = taken[index].len() / (group.actions * group.agents.len());
            for (record, agent) in group.order(records) {
                let end = encoded.len() + columns;
                for (of, taken) in groups.0.iter().zip(&taken) {
                    let start = encoded.len();
                    encoded.extend_from_slice(of.rows(taken, of.actions, &(record..record + 1)));
                    if of.agents.contains(&agent) {
                        let own = start + (agent - of.agents.start) * of.actions;
                        encoded[own..own + of.actions].fill(0.0);
                    }
                }
                let first = if self.kind == CriticKind::One { 0 } else { group.agents.start };
                let asked = encoded.len() + agent - first;
                encoded.resize(end, 0.0);
                if asked < end {
                    encoded[asked] = 1.0;
                }
            }
        }
    }

    fn values(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        shown: Shown<'_>,
        records: Range<usize>,
    ) -> Values {
        let all: Vec<Var> = groups
            .0
            .iter()
            .zip(shown.observations)
            .map(|(group, numbers)| {
                pass.input(group.inputs(), group.rows(numbers, group.inputs(), &records))
            })
            .collect();
        let of_records: Vec<Var> = groups
            .0
            .iter()
            .zip(&all)
            .map(|(group, x)| pass.reshape(*x, group.inputs() * group.agents.len()))
            .collect();
        let whole = pass.concat(&of_records);
        let of_rows = groups.records(records.len());
        let mut found = Values::default();
        for (index, group) in groups.0.iter().enumerate() {
            let layers = self.layers[index % self.layers.len()];
            let mut first = if self.kind == CriticKind::Own {
                pass.linear(all[index], layers.observed)
            } else {
                let of_record = pass.linear(whole, layers.observed);
                pass.gather(of_record, &of_rows[group.places(records.len())])
            };
            if let Some(layer) = layers.context {
                let row = layer.shape.input;
                let x = pass.input(row, group.rows(&shown.encoded.taken[index], row, &records));
                let context = pass.linear(x, layer);
                first = pass.add(first, context);
            }
            if let Some(layer) = layers.own {
                let row = group.actions;
                let leaf = pass.leaf(row, group.rows(&shown.encoded.own[index], row, &records));
                found.own_actions.push(leaf);
                let part = pass.linear(leaf, layer);
                first = pass.add(first, part);
            }
            let first = pass.leaky_relu(first, SLOPE);
            let hidden = leaky(pass, first, layers.hidden);
            let values = pass.linear(hidden, layers.head);
            let known = group.actions.min(layers.head.shape.output);
            found.of_actions.push(pass.columns(values, 0..known).into());
        }
        found
    }
}

/// Columns for what the others do, and for which agent is asked where several may be.
fn context_columns(kind: CriticKind, groups: &Groups, index: usize) -> usize {
    let taken: usize = groups.0.iter().map(|group| group.actions * group.agents.len()).sum();
    match kind {
        CriticKind::All if groups.0[index].agents.len() > 1 => taken + groups.0[index].agents.len(),
        CriticKind::All => taken,
        CriticKind::One => taken + groups.agents(),
        _ => 0,
    }
}
