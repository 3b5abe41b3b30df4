//! Critics of plain layers, which the methods that MAAC is compared with have (dissertation table 3.1): everything in
//! one row, with a critic for each group of agents or one for all, or what an agent sees itself.

use std::ops::Range;

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::{CriticKind, CriticShape};
use crate::actor_critic::critic::{Critic, Shown, Values};
use crate::actor_critic::groups::{Groups, SLOPE, leaky};

/// Such a critic's layers.
#[derive(Clone, Debug)]
pub(super) struct Joint {
    kind: CriticKind,
    groups: Groups,
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
        Self { kind, groups: groups.clone(), layers: layers.collect() }
    }
}

impl Critic for Joint {
    fn shared(&self) -> [usize; 2] {
        [0, 1]
    }

    fn values(&self, pass: &mut Pass<'_>, shown: Shown<'_>, records: Range<usize>) -> Values {
        let groups = &self.groups;
        let seen = groups.0.iter().zip(shown.observations);
        let all: Vec<Var> = seen.map(|(group, seen)| group.input(pass, seen, &records)).collect();
        let of_records = groups.0.iter().zip(&all);
        let of_records: Vec<Var> = of_records
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
                let context = context(self.kind, groups, (index, row), shown.actions, &records);
                let x = pass.input(row, &context);
                let context = pass.linear(x, layer);
                first = pass.add(first, context);
            }
            if let Some(layer) = layers.own {
                let row = group.actions;
                let leaf = pass.leaf(row, group.rows(&shown.own[index], row, &records));
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

/// `[rows, columns]`: what the others of each row's record do, each in its place, and which agent the row is about.
fn context(
    kind: CriticKind,
    groups: &Groups,
    (index, columns): (usize, usize),
    actions: &[Vec<u32>],
    records: &Range<usize>,
) -> Vec<f32> {
    let group = &groups.0[index];
    let mut context = vec![0.0; records.len() * group.agents.len() * columns];
    let rows = context.chunks_exact_mut(columns).zip(group.order(records.clone()));
    for (row, (record, agent)) in rows {
        let mut first = 0;
        for (of, actions) in groups.0.iter().zip(actions) {
            for (other, action) in of.agents.clone().zip(&actions[of.range(&(record..record + 1))])
            {
                if other != agent {
                    row[first + *action as usize] = 1.0;
                }
                first += of.actions;
            }
        }
        let asked = if kind == CriticKind::One { agent } else { agent - group.agents.start };
        if let Some(asked) = row.get_mut(first + asked) {
            *asked = 1.0;
        }
    }
    context
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actor_critic::groups::Group;

    #[test]
    fn one_critic_for_all_knows_whom_it_is_asked_about() {
        let group = |agents| Group { agents, observed: 3, identity: false, actions: 2 };
        let groups = Groups(vec![group(0..2), group(2..3)]);
        let actions = [vec![1, 0, 1, 1], vec![0, 1]];
        let of = |kind, index| {
            let columns = context_columns(kind, &groups, index);
            context(kind, &groups, (index, columns), &actions, &(0..2))
        };
        // What the others do, two columns each, and which agent.
        let rows = [of(CriticKind::One, 0), of(CriticKind::One, 1)].concat();
        let rows: Vec<&[f32]> = rows.chunks(9).collect();
        assert_eq!(rows[1], [0., 1., 0., 0., 1., 0., 0., 1., 0.]);
        assert_eq!(rows[4], [0., 1., 1., 0., 0., 0., 0., 0., 1.]);
        assert_eq!(rows[5], [0., 1., 0., 1., 0., 0., 0., 0., 1.]);
        // Of one agent nobody asks which.
        assert_eq!(of(CriticKind::All, 1)[6..], [0., 1., 0., 1., 0., 0.]);
        assert_eq!(of(CriticKind::All, 0)[..8], [0., 0., 1., 0., 1., 0., 1., 0.]);
    }
}
