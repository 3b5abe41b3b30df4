//! Networks written down by running them: a tape records what is computed and goes back through it.
//!
//! Everything is computed by the functions of [`layers`](crate::layers), a matrix at a time. Values and slopes of
//! all steps lie in an arena that keeps its memory, so that a steady stream of passes allocates nothing but what
//! the products' kernels pack and give back at once.
//!
//! A network, its loss and an update:
//!
//! ```
//! # use sortie_nn::{optimise::{Adam, AdamRules}, random::stream, tape::{Parameters, Tape}};
//! # let rows = 30;
//! # let (seen, actions, targets) = (vec![0.5; rows * 6], vec![1; rows], vec![0.25; rows]);
//! let mut parameters = Parameters::default();
//! let mut random = stream(1, 1, 0);
//! let (hidden, head) = (parameters.linear("hidden", 6, 32, &mut random), parameters.linear("head", 32, 4, &mut random));
//! let mut adam = Adam::new(parameters.values.len());
//! let mut gradient = vec![0.0; parameters.values.len()];
//! let mut tape = Tape::default();
//! let mut pass = tape.begin(&parameters.values);
//! let x = pass.input(6, &seen);
//! let x = pass.linear_rectified(x, hidden);
//! let utilities = pass.linear(x, head);
//! let chosen = pass.pick(utilities, &actions);
//! let loss = pass.squared_error(chosen, &targets, 1.0 / rows as f32);
//! pass.backward(loss, &mut gradient);
//! let rules = AdamRules { epsilon: 1e-5, ..AdamRules::default() };
//! adam.step(rules, &mut parameters.values, &gradient, 1e-3);
//! # assert!(gradient.iter().any(|slope| *slope != 0.0));
//! ```

mod backward;
mod groups;
mod layers;
mod matrices;
mod parameters;
mod steps;

use std::fmt;
use std::ops::Range;

use crate::layers::absorbed_attention::AbsorbedAttention;
use crate::layers::attention::AttentionShape;
use crate::layers::elementwise::Activation;
use crate::layers::gru::GruPass;
use crate::layers::matrix::Store;
use crate::layers::team_attention::Sums;
use crate::layers::unfold::UnfoldShape;
use crate::layers::{SparseRows, TeamLists, VisibleLists};

pub use parameters::{Gru, Linear, Norm, Parameters, Places, Tensor};

/// A matrix that a pass has computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Var(u32);

/// What was computed, in its order, and the memory for it. One for every lane of a trainer.
#[derive(Default)]
pub struct Tape {
    nodes: Vec<Node>,
    values: Vec<f32>,
    slopes: Vec<f32>,
    used: usize,
    indices: Vec<u32>,
    lists: Pool<VisibleLists>,
    teams: Pool<TeamLists>,
    sparse: Pool<SparseRows>,
    grus: Pool<GruPass>,
    absorbed: Pool<AbsorbedAttention>,
    carry: Vec<bool>,
    scratch: Vec<f32>,
    /// Whether the pass may go back, for which it keeps what it was given.
    goes_back: bool,
}

impl Clone for Tape {
    /// A tape of its own: what stands on one is forgotten with the next pass.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl fmt::Debug for Tape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Tape({} steps, {} numbers)", self.nodes.len(), self.used)
    }
}

/// Things that are used one after the other and keep their memory.
#[derive(Default)]
struct Pool<T> {
    things: Vec<T>,
    used: usize,
}

impl<T: Default> Pool<T> {
    fn next(&mut self) -> (usize, &mut T) {
        if self.used == self.things.len() {
            self.things.push(T::default());
        }
        self.used += 1;
        (self.used - 1, &mut self.things[self.used - 1])
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    operation: Operation,
    rows: usize,
    columns: usize,
    /// Where its numbers begin.
    at: usize,
    /// The node whose memory it shares; itself if it has its own.
    base: u32,
    /// Whether a loss can depend on parameters, or on leaves, through it.
    needs_slopes: bool,
    /// Whether its slopes have been written.
    has_slopes: bool,
}

impl Node {
    fn range(&self) -> Range<usize> {
        self.at..self.at + self.rows * self.columns
    }
}

impl Tape {
    /// Begins a pass of a network with these parameters; the pass before is forgotten.
    pub fn begin<'a>(&'a mut self, parameters: &'a [f32]) -> Pass<'a> {
        self.start(parameters, true)
    }

    /// Begins a pass that only looks, for which nothing of what it is given is copied.
    pub fn begin_forward<'a>(&'a mut self, parameters: &'a [f32]) -> Pass<'a> {
        self.start(parameters, false)
    }

    fn start<'a>(&'a mut self, parameters: &'a [f32], goes_back: bool) -> Pass<'a> {
        self.goes_back = goes_back;
        self.nodes.clear();
        self.indices.clear();
        self.carry.clear();
        self.used = 0;
        (self.lists.used, self.teams.used, self.sparse.used) = (0, 0, 0);
        (self.grus.used, self.absorbed.used) = (0, 0);
        Pass { tape: self, parameters }
    }

    /// Makes room for a result behind all others.
    fn push(
        &mut self,
        operation: Operation,
        rows: usize,
        columns: usize,
        needs_slopes: bool,
    ) -> Var {
        let at = self.reserve(rows * columns);
        self.node(operation, [rows, columns], at, None, needs_slopes)
    }

    /// Numbers of the arena that nothing else uses in this pass.
    fn reserve(&mut self, numbers: usize) -> usize {
        let at = self.used;
        self.used += numbers;
        if self.values.len() < self.used {
            self.values.resize(self.used, 0.0);
            self.slopes.resize(self.used, 0.0);
        }
        at
    }

    fn node(
        &mut self,
        operation: Operation,
        [rows, columns]: [usize; 2],
        at: usize,
        base: Option<u32>,
        needs_slopes: bool,
    ) -> Var {
        let index = self.nodes.len() as u32;
        self.nodes.push(Node {
            operation,
            rows,
            columns,
            at,
            base: base.unwrap_or(index),
            needs_slopes,
            has_slopes: false,
        });
        Var(index)
    }

    fn of(&self, var: Var) -> Node {
        self.nodes[var.0 as usize]
    }

    /// The values of nodes, and those of one behind them, to be written.
    fn split<const N: usize>(&mut self, inputs: [Var; N], y: Var) -> ([&[f32]; N], &mut [f32]) {
        let (ranges, out) = (inputs.map(|x| self.of(x).range()), self.of(y).range());
        let (before, rest) = self.values.split_at_mut(out.start);
        (ranges.map(|range| &before[range]), &mut rest[..out.len()])
    }

    /// Where the slopes by an input are to go and how, if anybody needs them.
    fn slopes_of(&mut self, var: Var) -> Option<(Range<usize>, Store)> {
        let node = self.of(var);
        let base = &mut self.nodes[node.base as usize];
        if !base.needs_slopes {
            return None;
        }
        let (range, whole) = (node.range(), base.range());
        let store = if base.has_slopes {
            Store::Add
        } else if range == whole {
            Store::Replace
        } else {
            self.slopes[whole].fill(0.0);
            Store::Add
        };
        base.has_slopes = true;
        Some((range, store))
    }

    /// A copy of these lists for the way back; its place in the pool.
    fn keep_lists(&mut self, lists: &VisibleLists) -> usize {
        let (place, kept) = self.lists.next();
        if self.goes_back {
            kept.copy_from(lists);
        }
        place
    }

    fn store_indices(&mut self, indices: impl IntoIterator<Item = u32>) -> Indices {
        let start = self.indices.len();
        self.indices.extend(indices);
        (start, self.indices.len())
    }
}

/// One pass through a network.
#[derive(Debug)]
pub struct Pass<'a> {
    tape: &'a mut Tape,
    parameters: &'a [f32],
}

impl Pass<'_> {
    /// The numbers of a matrix, row by row.
    pub fn values(&self, var: Var) -> &[f32] {
        &self.tape.values[self.tape.of(var).range()]
    }

    /// The slopes of the loss by a [`leaf`](Self::leaf), after [`backward`](Self::backward); zeros are not written
    /// where the loss does not depend on it: `None`.
    pub fn slopes(&self, var: Var) -> Option<&[f32]> {
        let node = self.tape.of(var);
        node.has_slopes.then(|| &self.tape.slopes[node.range()])
    }

    /// Rows and columns of a matrix.
    pub fn size(&self, var: Var) -> [usize; 2] {
        let Node { rows, columns, .. } = self.tape.of(var);
        [rows, columns]
    }
}

/// A part of the tape's indices.
type Indices = (usize, usize);

/// What queries get of what they see.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Attended {
    /// The values of everything.
    Whole,
    /// Those of everything, of what lies within their part and of what lies across.
    Parts,
    /// The squares of all scores.
    Scores,
}

/// What a node was computed by, of which nodes; all others are places in the tape's memory.
#[derive(Clone, Copy, Debug)]
enum Operation {
    /// Given from outside, or the memory of another step seen otherwise.
    Given,
    /// `x W' + b`, rectified or not.
    Linear { x: Var, layer: Linear, rectified: bool },
    /// Two products and the offsets of the first layer, rectified.
    LinearSum { x: [Var; 2], layers: [Linear; 2] },
    /// A first layer; `rows` is the place of the features in their pool.
    SparseLinear { rows: usize, entries: usize, layer: Linear, rectified: bool },
    /// A function of every number.
    Activate { x: Var, activation: Activation },
    /// Of every row.
    Softmax { x: Var },
    /// The logarithm of that.
    LogSoftmax { x: Var },
    /// Of queries, and of keys and values. `kept` is where what is known of pairs begins in the arena, behind which the shares
    /// of parts stand if there are any.
    Attend {
        inputs: [Var; 2],
        lists: usize,
        pairs: usize,
        kept: usize,
        shape: AttentionShape,
        to: Attended,
    },
    /// A recurrent unit through time; `carry` is where it begins in the tape's.
    Recur { x: Var, pass: usize, carry: usize, slots: usize, layer: Gru },
    /// The patches of pictures.
    Unfold { x: Var, shape: UnfoldShape },
    /// Row i is row `indices[i]` of `x`.
    Gather { x: Var, indices: Indices },
    /// Row `indices[i]` gets row i of `x` added.
    Scatter { x: Var, indices: Indices },
    /// Row i is the one number in column `indices[i]`.
    Pick { x: Var, indices: Indices },
    /// Some columns behind each other.
    Columns { x: Var, first: usize },
    /// Columns of several; the indices are their numbers.
    Concat { parts: Indices },
    /// One number for each row.
    SumColumns { x: Var },
    /// `factor x`, whatever was added.
    Scale { x: Var, factor: f32 },
    /// `a + b`, to every block of as many rows as `b` has.
    Add { a: Var, b: Var },
    /// `a b`, number by number.
    Multiply { a: Var, b: Var },
    /// Every row times its number.
    ScaleRows { x: Var, by: Var },
    /// `value + advantage - mean of the row's advantages`.
    Dueling { value: Var, advantages: Var },
    /// `factor` times the sum of squared distances.
    SquaredError { x: Var, target: Var, factor: f32 },
    /// The same of Huber's losses.
    Huber { x: Var, target: Var, factor: f32, bound: f32 },
    /// Row i belongs to group `indices[i]`.
    SoftmaxGroups { x: Var, indices: Indices, groups: usize },
    /// A matrix of parameters; where it begins.
    Parameter { start: usize },
    /// `a b`, or `a b'`.
    Product { a: Var, b: Var, transposed: bool },
    /// Of every number.
    Absolute { x: Var },
    /// Rows whose squares have the mean 1.
    NormaliseRows { x: Var },
    /// Of queries and entities, with the matrix of keys and values.
    Absorb {
        inputs: [Var; 2],
        keys_values: Linear,
        lists: usize,
        pairs: usize,
        pass: usize,
        heads: usize,
    },
    /// Of queries, keys and rows. `weights` is where the attention weights begin in the arena.
    AttendInTeams { inputs: [Var; 3], lists: usize, weights: usize, heads: usize, sums: Sums },
}

#[cfg(test)]
mod tests;
