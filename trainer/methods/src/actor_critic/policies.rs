//! The policies: each agent's own observation becomes scores of its actions.

use std::ops::Range;

use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::groups::Groups;
use super::values::bent;

/// The policies of all groups: a first layer, and two more for each head.
#[derive(Clone, Debug)]
pub struct Policies {
    /// The weights, group behind group.
    pub parameters: Parameters,
    slope: f32,
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
    shared: usize,
}

impl Policies {
    /// Draws the first weights.
    pub fn new(shape: PolicyShape, groups: &Groups, random: &mut Generator) -> Self {
        let mut parameters = Parameters::default();
        let [base, width] = shape.widths;
        let layers = groups.0.iter().enumerate().map(|(index, group)| {
            let start = parameters.values.len();
            let mut linear = |layer: usize, input, output| {
                let name = format!("policy.{index}.{layer}");
                parameters.linear(&name, input, output, random)
            };
            let first = linear(0, group.inputs(), base);
            let heads = (0..shape.heads).map(|head| {
                [linear(2 * head + 1, base, width), linear(2 * head + 2, width, group.actions)]
            });
            let heads = heads.collect();
            let shared = (group.inputs() + 1) * base;
            Layers { first, heads, range: start..parameters.values.len(), shared }
        });
        let groups = layers.collect();
        Self { parameters, slope: shape.slope, groups }
    }

    /// Where the weights of each group stand.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.groups.iter().map(|layers| layers.range.clone())
    }

    /// Where those of each group stand that all its heads share.
    pub fn shared(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.groups.iter().map(|layers| layers.range.start..layers.range.start + layers.shared)
    }

    /// How many heads each group has.
    pub fn heads(&self) -> usize {
        self.groups.first().map_or(0, |layers| layers.heads.len())
    }

    /// What is made of numbers below zero.
    pub fn slope(&self) -> f32 {
        self.slope
    }

    /// The layers of each group with one of its heads.
    pub fn layers(&self, head: usize) -> impl Iterator<Item = [Linear; 3]> {
        self.groups.iter().map(move |layers| {
            let [second, last] = layers.heads[head];
            [layers.first, second, last]
        })
    }

    /// By groups and heads, `[rows, actions]`: the scores of actions in some records, whose softmax are their chances.
    pub fn scores(
        &self,
        pass: &mut Pass<'_>,
        groups: &Groups,
        observations: &[Vec<f32>],
        records: Range<usize>,
    ) -> Vec<Var> {
        self.scores_of(0..self.heads(), pass, groups, observations, records)
    }

    /// The same of some heads.
    pub fn scores_of(
        &self,
        heads: Range<usize>,
        pass: &mut Pass<'_>,
        groups: &Groups,
        observations: &[Vec<f32>],
        records: Range<usize>,
    ) -> Vec<Var> {
        let mut scores = Vec::new();
        for ((layers, group), observations) in self.groups.iter().zip(&groups.0).zip(observations) {
            let x = pass.input(group.inputs(), group.rows(observations, group.inputs(), &records));
            let x = bent(pass, x, layers.first, self.slope);
            for [second, last] in &layers.heads[heads.clone()] {
                let x = bent(pass, x, *second, self.slope);
                scores.push(pass.linear(x, *last));
            }
        }
        scores
    }
}
