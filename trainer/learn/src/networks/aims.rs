//! Heads that point: which entities the last actions aim at, whom of them each agent sees, and the products that say what
//! aiming there is worth.

use std::iter::Peekable;
use std::ops::Range;

use serde::{Deserialize, Serialize};
use sortie_envs::{EntitySet, Spec};
use sortie_nn::tape::{Linear, Pass, Var};

use crate::export::{Layer, PairHead, PointingHead};

/// Entities at which the last actions aim, one each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Targets {
    /// The first of them.
    pub first: usize,
    /// How many; 0: no action aims at one.
    pub count: usize,
    /// The column of the agent's own row where the features of pairs with them begin.
    pub first_pair: usize,
    /// Features of a pair.
    pub pair_features: usize,
}

impl Targets {
    /// No action aims at an entity.
    pub const NONE: Self = Self { first: 0, count: 0, first_pair: 0, pair_features: 0 };

    /// What actions aim at in an environment.
    pub fn of(spec: &Spec) -> Self {
        let (count, pair_features) = (spec.targets.len(), spec.pair_features());
        Self { first: spec.targets.start, count, first_pair: spec.pairs.start, pair_features }
    }

    /// The entities.
    pub fn entities(self) -> Range<usize> {
        self.first..self.first + self.count
    }

    /// The columns of the agent's own row that say how it stands to them.
    pub fn pairs(self) -> Range<usize> {
        self.first_pair..self.first_pair + self.count * self.pair_features
    }

    /// Numbers of the vector that points, where embeddings have so many: what pairs are told by stands behind them.
    pub fn reach(self, width: usize) -> usize {
        width + self.pair_features
    }

    /// The head that points by these weights, as it is deployed.
    pub fn deployed(self, pointing: Linear, values: &[f32]) -> PointingHead<'_> {
        let Self { first, count, first_pair, pair_features } = self;
        let Linear { shape, .. } = pointing;
        let width = shape.output - pair_features;
        let weights = values[pointing.weight_range()].split_at(width * shape.input);
        let bias = pointing.bias_range().map_or(&[][..], |range| &values[range]);
        let biases = bias.split_at(width);
        let pairs = PairHead {
            first: first_pair,
            features: pair_features,
            weights: Layer::outputs_first(weights.1, biases.1),
        };
        PointingHead {
            first_entity: first,
            count,
            query: Layer::outputs_first(weights.0, biases.0),
            pairs: (pair_features > 0).then_some(pairs),
            scale: scale(width),
        }
    }
}

crate::words! {
    /// What values actions that are aimed at entities.
    #[derive(Default)]
    AimedHead {
        /// The product of the agent's vector with the entity's embedding.
        #[default]
        Pointing = "pointing",
        /// Weights of the action's own.
        Numbered = "numbered",
    }
}

impl AimedHead {
    /// What it points at in an environment.
    pub fn targets(self, spec: &Spec) -> Targets {
        if self == Self::Pointing { Targets::of(spec) } else { Targets::NONE }
    }
}

/// Pairs of queries with those targets that they see, and the memory for them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Aims {
    /// The entity that each aimed action aims at.
    targets: Vec<usize>,
    /// The columns of agents' own rows that hold features of pairs with these.
    related: Range<usize>,
    /// Of every pair the query, the row of its target, and where its utility stands among `[queries, targets]`.
    pairs: [Vec<u32>; 3],
    /// The features of every pair, in the same order.
    features: Vec<f32>,
}

/// Some of these pairs: the first of so many blocks.
#[derive(Clone, Copy, Debug)]
pub struct AimView<'a> {
    aims: &'a Aims,
    blocks: usize,
}

impl Aims {
    /// From now on the last actions aim at these entities, one each; these columns of an agent's own row say how it stands to
    /// them, as many for each.
    pub fn aim_at(&mut self, targets: impl Iterator<Item = usize>, related: Range<usize>) {
        self.targets.clear();
        self.targets.extend(targets);
        self.related = related;
    }

    /// Forgets all pairs.
    pub fn clear(&mut self) {
        self.pairs.iter_mut().for_each(Vec::clear);
        self.features.clear();
    }

    /// Adds a query, told with its own row, and the targets among what it sees, whose rows are told.
    pub fn push(
        &mut self,
        (query, own): (u32, impl Iterator<Item = (usize, f32)>),
        visible: EntitySet,
        row: impl Fn(usize) -> usize,
    ) {
        let count = self.targets.len();
        let features = self.related.len() / count.max(1);
        let mut own = own.peekable();
        let targets = self.targets.iter().copied().enumerate();
        for (target, entity) in targets.filter(|(_, entity)| visible >> entity & 1 == 1) {
            let pair = [query, row(entity) as u32, query * count as u32 + target as u32];
            self.pairs.iter_mut().zip(pair).for_each(|(all, own)| all.push(own));
            let start = self.related.start + target * features;
            add_part(&mut own, start..start + features, &mut self.features);
        }
    }

    /// Adds the same pairs again until there are so many blocks of them, each of so many queries more.
    pub(super) fn repeat(&mut self, blocks: usize, queries: usize) {
        let (pairs, features) = (self.pairs[0].len(), self.features.len());
        let [of_queries, rows, places] = &mut self.pairs;
        let strides = [(of_queries, queries), (rows, 0), (places, queries * self.targets.len())];
        for (all, stride) in strides {
            for block in 1..blocks {
                let further = (block * stride) as u32;
                all.extend_from_within(..pairs);
                all[block * pairs..].iter_mut().for_each(|number| *number += further);
            }
        }
        (1..blocks).for_each(|_| self.features.extend_from_within(..features));
    }

    /// All pairs.
    pub fn all(&self) -> AimView<'_> {
        self.part(1)
    }

    /// The first of so many blocks.
    pub(super) fn part(&self, blocks: usize) -> AimView<'_> {
        AimView { aims: self, blocks }
    }
}

impl AimView<'_> {
    /// The utilities `[queries, targets]` of aimed actions: scaled products of vectors with embeddings `[rows, width]` and,
    /// behind them, what is known of each pair; 0 where a query does not see its target.
    pub fn point(self, pass: &mut Pass<'_>, [vectors, embeddings]: [Var; 2]) -> Var {
        let Aims { targets: aimed, pairs, features: known, .. } = self.aims;
        let count = pairs[0].len() / self.blocks;
        let [of_queries, rows, places] = pairs.each_ref().map(|all| &all[..count]);
        let queries = pass.size(vectors)[0];
        let vectors = pass.gather(vectors, of_queries);
        let mut targets = pass.gather(embeddings, rows);
        let width = pass.size(targets)[1];
        let features = pass.size(vectors)[1] - width;
        if features > 0 {
            let pairs = pass.input(features, &known[..known.len() / self.blocks]);
            targets = pass.concat(&[targets, pairs]);
        }
        let products = pass.multiply(vectors, targets);
        let products = pass.sum_columns(products);
        let products = pass.scale(products, scale(width));
        let all = pass.scatter(products, places, queries * aimed.len());
        pass.reshape(all, aimed.len())
    }
}

/// What products of so many columns are multiplied by, as both factors are learned: without it the first weights' utilities
/// drown what is earned, and a step of the optimiser moves them too far. About `1/sqrt(width)`, and a power of two, so that it
/// is part of deployed weights to the bit.
fn scale(width: usize) -> f32 {
    0.5_f32.powi(width.ilog2() as i32 / 2)
}

/// Adds these columns of a row, zeros included. What stands before them is left behind.
fn add_part(
    row: &mut Peekable<impl Iterator<Item = (usize, f32)>>,
    columns: Range<usize>,
    all: &mut Vec<f32>,
) {
    let first = all.len();
    all.resize(first + columns.len(), 0.0);
    while let Some((column, value)) = row.next_if(|(column, _)| *column < columns.end) {
        if let Some(place) = column.checked_sub(columns.start) {
            all[first + place] = value;
        }
    }
}
