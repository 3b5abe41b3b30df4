//! The policies: each agent's own row becomes scores of its actions.

use std::ops::Range;

use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::groups::{Groups, Rows, bent};

/// The policies of all groups: a first layer, and two more for each head.
#[derive(Clone, Debug)]
pub struct Policies {
    /// What is made of numbers below zero.
    pub(super) slope: f32,
    /// How many heads each group has.
    pub heads: usize,
    groups: Vec<Layers>,
}

/// What policies are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyShape {
    /// Columns behind the first layer, and behind the second.
    pub widths: [usize; 2],
    /// Ways to score actions that share the first layer.
    pub heads: usize,
    /// What is made of numbers below zero.
    pub slope: f32,
}

#[derive(Clone, Debug)]
struct Layers {
    first: Linear,
    heads: Vec<[Linear; 2]>,
    /// Where the weights stand, those of the first layer before the others.
    range: Range<usize>,
}

impl Policies {
    /// Draws the first weights, group behind group.
    pub fn new(shape: PolicyShape, groups: &Groups, random: &mut Generator) -> (Self, Parameters) {
        let mut parameters = Parameters::default();
        let [base, width] = shape.widths;
        let layers = groups.0.iter().enumerate().map(|(index, group)| {
            let start = parameters.values.len();
            let mut linear = |layer: usize, input, output| {
                parameters.linear(&format!("policy.{index}.{layer}"), input, output, random)
            };
            let first = linear(0, group.inputs(), base);
            let heads = (0..shape.heads).map(|head| {
                [linear(2 * head + 1, base, width), linear(2 * head + 2, width, group.actions)]
            });
            let heads = heads.collect();
            Layers { first, heads, range: start..parameters.values.len() }
        });
        let groups = layers.collect();
        (Self { slope: shape.slope, heads: shape.heads, groups }, parameters)
    }

    /// The layers of a group with one of its heads.
    pub(super) fn layers(&self, group: usize, head: usize) -> [Linear; 3] {
        let Layers { first, heads, .. } = &self.groups[group];
        let [second, last] = heads[head];
        [*first, second, last]
    }

    /// Where the weights of each group stand, and how many of them, the first, all its heads share.
    pub(super) fn ranges(&self) -> impl Iterator<Item = (Range<usize>, usize)> + '_ {
        let shared = |layers: &Layers| (layers.first.shape.input + 1) * layers.first.shape.output;
        self.groups.iter().map(move |layers| (layers.range.clone(), shared(layers)))
    }

    /// By groups and heads, `[rows, actions]`: the scores of actions in some records, whose softmax are their chances.
    pub(super) fn scores(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        shown: &Rows,
        heads: Range<usize>,
        records: Range<usize>,
    ) -> Vec<Var> {
        let mut scores = Vec::new();
        for (index, (group, shown)) in groups.0.iter().zip(shown).enumerate() {
            let rows = group.rows(shown, group.inputs(), &records);
            self.score(pass, index, rows, heads.clone(), &mut scores);
        }
        scores
    }

    /// Adds by heads `[rows, actions]` the scores of actions where agents of a group are shown these rows.
    pub(crate) fn score(
        &self,
        pass: &mut Pass<'_>,
        group: usize,
        rows: &[f32],
        heads: Range<usize>,
        scores: &mut Vec<Var>,
    ) {
        let layers = &self.groups[group];
        let x = pass.input(layers.first.shape.input, rows);
        let x = bent(pass, x, layers.first, self.slope);
        scores.extend(layers.heads[heads].iter().map(|[second, last]| {
            let x = bent(pass, x, *second, self.slope);
            pass.linear(x, *last)
        }));
    }
}
