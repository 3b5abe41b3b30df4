//! Policies whoever exported them become steps on values of fixed sizes.
//!
//! Every node of tract's simplified graph becomes a few steps; a product with constant weights becomes a layer, with the
//! bias and the ReLU that follow. Reshaping moves no number: a value is a place and its sizes.

mod arrange;
mod convolve;
mod elementwise;
mod moved;
mod pictures;
mod pools;
mod products;
mod rows;
mod tidy;
mod values;
mod windows;

use std::collections::{HashMap, HashSet};

use sortie_core::internal::kernels::mark::MARKED;
use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Combination, Combine, Function, Input, Map, MaskedArgmax, Meaning, Op, Output, OutputRows,
    Place, State,
};
use sortie_core::limits;
use sortie_core::plan::{OPS, Profile, ProgramDraft};
use sortie_plans::{CompileError, InputRole, OutputRole};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{
    CumSum, Gather, GatherElements, GatherNd, MultiBroadcastTo, OneHot, Pad, ScatterElements,
    ScatterNd, ScatterReduction, Slice, Tile, Topk, Trilu, TypedConcat,
};
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_core::ops::cnn::{Conv, MaxPool, SumPool};
use tract_onnx::tract_core::ops::downsample::Downsample;
use tract_onnx::tract_core::ops::einsum::EinSum;
use tract_onnx::tract_core::ops::element_wise::ElementWiseOp;
use tract_onnx::tract_core::ops::gru_cell::GruEpilogue;
use tract_onnx::tract_core::ops::konst::Const;
use tract_onnx::tract_core::ops::logic::Iff;
use tract_onnx::tract_core::ops::lstm_cell::LstmEpilogue;
use tract_onnx::tract_core::ops::nn::{NearestUpsample, Reduce, RmsNorm, Softmax};
use tract_onnx::tract_core::ops::source::TypedSource;

use super::agent::{Arena, at_most};
use crate::flat::FlatGraph;
use convolve::StoredTiles;
use moved::nearest;
use values::{PolicyWeights, StoredLayer, Values};

/// Floats behind the last value.
const PADDING: u32 = 16;

/// Most inputs and outputs of a layer: a number of 16 bits in whole tiles.
const WIDEST: usize = 65_528;

/// A policy as a program.
pub(crate) struct LoweredPolicy {
    pub(crate) program: ProgramDraft,
    pub(crate) weights: PolicyWeights,
    /// Numbers of the first input, as far as a plan's header can say.
    pub(crate) features: usize,
    /// Actions to choose from; 1 where none is chosen.
    pub(crate) actions: usize,
}

/// Lowers a policy: its inputs, of which `meanings` says what they are in a team, its states, the steps, its outputs, and a choice where the first output is one.
///
/// # Errors
/// `Unsupported` names the node that no step computes.
pub(crate) fn lower_policy(
    graph: &FlatGraph,
    meanings: &[Meaning],
    profile: Profile,
) -> Result<LoweredPolicy, CompileError> {
    let mut lowering = Lowering::new(&graph.model, profile);
    lowering.inputs(graph, meanings)?;
    let order = graph.model.eval_order();
    let order = order.map_err(|error| CompileError::Unreadable { reason: error.to_string() })?;
    let needed = needed(graph);
    for node in order.into_iter().filter(|node| needed.contains(node)) {
        lowering.node(graph.model.node(node))?;
    }
    lowering.outputs(graph)
}

/// The outlets of all outputs, in the order of the facts: of a choice those of its scores.
fn outlets(graph: &FlatGraph) -> impl Iterator<Item = Option<OutletId>> {
    let count = graph.interface.facts.outputs.len();
    let outlet = |index| graph.model.outputs.get(graph.interface.scores_of(index)).copied();
    (0..count).map(outlet)
}

/// The nodes that outputs are computed from.
fn needed(graph: &FlatGraph) -> HashSet<usize> {
    let mut waiting: Vec<usize> = outlets(graph).flatten().map(|outlet| outlet.node).collect();
    let mut needed = HashSet::new();
    while let Some(node) = waiting.pop() {
        if needed.insert(node) {
            waiting.extend(graph.model.node(node).inputs.iter().map(|outlet| outlet.node));
        }
    }
    needed
}

/// One dimension of a copy: numbers along it, and the steps in the source and in the result.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Dimension {
    size: usize,
    from: usize,
    to: usize,
}

/// What is written so far.
struct Lowering<'m> {
    model: &'m TypedModel,
    arena: Arena,
    weights: PolicyWeights,
    ops: Vec<Op>,
    values: Values,
    /// The next states, whose places are not known before the end.
    states: Vec<usize>,
    longest_sparse: usize,
    /// The layers among the weights, by what they are.
    layers: HashMap<[u8; 32], StoredLayer>,
    /// Where the tables among the weights start, by what they are.
    tables: HashMap<[u8; 32], u32>,
    /// The same of layers on patches.
    tiles: HashMap<[u8; 32], StoredTiles>,
}

type Lowered<T> = Result<T, CompileError>;

impl<'m> Lowering<'m> {
    fn new(model: &'m TypedModel, profile: Profile) -> Self {
        Self {
            model,
            arena: Arena::default(),
            weights: PolicyWeights::of(profile),
            ops: Vec::new(),
            values: Values::default(),
            states: Vec::new(),
            longest_sparse: 0,
            layers: HashMap::new(),
            tables: HashMap::new(),
            tiles: HashMap::new(),
        }
    }

    /// Inputs in the order in which callers give them, then states.
    fn inputs(&mut self, graph: &FlatGraph, meanings: &[Meaning]) -> Lowered<()> {
        let sources = graph.model.inputs.iter().zip(&graph.interface.facts.inputs);
        let (states, given): (Vec<_>, Vec<_>) =
            sources.partition(|(_, input)| input.role == InputRole::State);
        for (index, (outlet, input)) in given.into_iter().enumerate() {
            let to = self.arena.place(input.length());
            let meaning = meanings.get(index).copied().unwrap_or(Meaning::None);
            let index = index as u16;
            self.ops.push(Op::Input(Input { index, meaning, to }));
            self.values.insert(*outlet, to, input.shape.clone());
        }
        for (outlet, input) in states {
            let from = self.arena.place(input.length());
            self.states.push(self.ops.len());
            self.ops.push(Op::State(State { from, to: from }));
            self.values.insert(*outlet, from, input.shape.clone());
        }
        Ok(())
    }

    fn node(&mut self, node: &TypedNode) -> Lowered<()> {
        let op = &node.op;
        let is_known = (0..node.outputs.len()).all(|slot| self.values.has((node.id, slot).into()));
        if is_known || op.is::<TypedSource>() || op.is::<Const>() {
            return Ok(());
        }
        self.values.as_picture = self.as_picture(node);
        let lowered = self.usual(node);
        self.values.as_picture = None;
        lowered
    }

    /// Operators that many policies have.
    fn usual(&mut self, node: &TypedNode) -> Lowered<()> {
        let op = &node.op;
        if let Some(einsum) = op.downcast_ref::<EinSum>() {
            return self.product(node, einsum);
        }
        if let Some(binary) = op.downcast_ref::<TypedBinOp>() {
            return self.binary(node, binary.0.name());
        }
        if let Some(function) = op.downcast_ref::<ElementWiseOp>() {
            return self.function(node, function);
        }
        if let Some(axes) = op.downcast_ref::<AxisOp>() {
            return self.axes(node, axes);
        }
        if let Some(slice) = op.downcast_ref::<Slice>() {
            return self.slice(node, slice);
        }
        if let Some(every) = op.downcast_ref::<Downsample>() {
            return self.every(node, every);
        }
        if let Some(concat) = op.downcast_ref::<TypedConcat>() {
            return self.concat(node, concat.axis);
        }
        if let Some(gather) = op.downcast_ref::<Gather>() {
            return self.gather(node, gather.axis);
        }
        if let Some(softmax) = op.downcast_ref::<Softmax>() {
            return self.softmax(node, softmax);
        }
        if let Some(reduce) = op.downcast_ref::<Reduce>() {
            return self.reduce(node, reduce);
        }
        if let Some(norm) = op.downcast_ref::<RmsNorm>() {
            return self.normalise(node, norm);
        }
        if let Some(cast) = op.downcast_ref::<Cast>() {
            return self.cast(node, cast.to);
        }
        if let Some(lstm) = op.downcast_ref::<LstmEpilogue>() {
            return self.lstm(node, lstm.hidden);
        }
        if let Some(gru) = op.downcast_ref::<GruEpilogue>() {
            return self.gru(node, gru.hidden);
        }
        if let Some(conv) = op.downcast_ref::<Conv>() {
            return self.convolve(node, conv);
        }
        if let Some(pool) = op.downcast_ref::<MaxPool>() {
            return self.largest(node, pool);
        }
        if let Some(pool) = op.downcast_ref::<SumPool>() {
            return self.sum(node, pool);
        }
        if let Some(pad) = op.downcast_ref::<Pad>() {
            return self.pad(node, pad);
        }
        if let Some(hot) = op.downcast_ref::<OneHot>() {
            return self.one_hot(node, hot);
        }
        if op.is::<Iff>() {
            return self.select(node);
        }
        if op.is::<MultiBroadcastTo>() {
            let input = self.broadcast(node, 0, &self.shape(node, 0)?)?;
            return self.give(node, 0, input);
        }
        self.seldom(node)
    }

    /// Operators that few policies have.
    fn seldom(&mut self, node: &TypedNode) -> Lowered<()> {
        let op = &node.op;
        if let Some(top) = op.downcast_ref::<Topk>() {
            return self.largest_of_rows(node, top);
        }
        if let Some(sum) = op.downcast_ref::<CumSum>() {
            return self.running_sum(node, sum);
        }
        let is_known = |slot: usize| {
            node.inputs.get(slot).is_some_and(|outlet| self.constant(*outlet).is_some())
        };
        if let Some(gather) = op.downcast_ref::<GatherElements>().filter(|_| !is_known(1)) {
            return self.picked(node, gather.axis);
        }
        if let Some(gather) = op.downcast_ref::<GatherNd>().filter(|_| !is_known(1)) {
            return self.picked_behind(node, gather.batch_dims);
        }
        if op.is::<Tile>()
            || op.is::<Trilu>()
            || op.is::<NearestUpsample>()
            || op.is::<GatherElements>()
            || op.is::<GatherNd>()
        {
            return self.moved(node, &[0]);
        }
        let scatters = op.downcast_ref::<ScatterNd>().map(|scatter| &scatter.reduction);
        let scatters = scatters
            .or_else(|| op.downcast_ref::<ScatterElements>().map(|scatter| &scatter.reduction));
        if scatters == Some(&ScatterReduction::None) {
            return self.moved(node, &[0, 2]);
        }
        let adds = |scatter: &ScatterNd| scatter.reduction == ScatterReduction::Add;
        if op.downcast_ref::<ScatterNd>().is_some_and(adds) {
            return self.added_to_rows(node);
        }
        Err(self.unsupported(node, nearest(&node.op.name())))
    }

    /// The outputs, the next states, and the choice.
    fn outputs(mut self, graph: &FlatGraph) -> Lowered<LoweredPolicy> {
        let facts = &graph.interface.facts;
        let mut places = Vec::new();
        for (outlet, output) in outlets(graph).zip(&facts.outputs) {
            let lost = || CompileError::Unreadable { reason: format!("`{}` is lost", output.name) };
            let outlet = outlet.ok_or_else(lost)?;
            let mut place = self.place_of(outlet)?;
            if matches!(output.role, OutputRole::Discrete(_)) && self.is_masked(outlet) {
                place = self.map(Function::Clip, [f32::MIN, f32::INFINITY], place);
            }
            places.push((place, output.role));
        }
        let of_states = |(_, role): &&(Place, OutputRole)| *role == OutputRole::State;
        for (place, _) in places.iter().filter(of_states) {
            self.next_state(*place)?;
        }
        let wanted = || places.iter().filter(|place| !of_states(place));
        for (from, _) in wanted() {
            let (width, rows, groups) = (from.len, OutputRows::One, 0);
            let from = Place { len: padded(width as usize) as u32, ..*from };
            self.ops.push(Op::Output(Output { from, width, rows, groups }));
        }
        let choice = wanted().find_map(|(place, role)| match role {
            OutputRole::Discrete(actions)
                if place.len as usize == *actions && *actions <= limits::ACTIONS =>
            {
                Some(*place)
            }
            _ => None,
        });
        let actions = choice.map_or(1, |place| place.len as usize);
        if let Some(from) = choice {
            self.ops.push(Op::MaskedArgmax(MaskedArgmax { from }));
        }
        let floats = tidy::tidy(&mut self.ops, &self.arena.places);
        at_most("the number of steps", self.ops.len(), OPS)?;
        // A slice at the arena's end is read as far as its padding.
        let floats = floats + PADDING;
        let nonzeros = self.longest_sparse.div_ceil(MARKED) as u32;
        let program = ProgramDraft { ops: self.ops, floats, nonzeros };
        let features = facts.given().next().map_or(1, |input| input.length());
        let features = features.clamp(1, limits::FEATURES);
        Ok(LoweredPolicy { program, weights: self.weights, features, actions })
    }

    /// Whether scores may be minus infinity, where an action must not be chosen: a constant that is chosen or added, or
    /// the logarithm of nothing.
    fn is_masked(&self, outlet: OutletId) -> bool {
        let (mut waiting, mut seen) = (vec![outlet], HashSet::new());
        while let Some(outlet) = waiting.pop() {
            let node = self.model.node(outlet.node);
            let is_sum = |op: &TypedBinOp| ["Add", "Sub", "SubF"].contains(&op.0.name());
            let is_sum = node.op_as::<TypedBinOp>().is_some_and(is_sum);
            let constant = self.constant(outlet).and_then(|constant| values::numbers(&constant));
            let closes = constant.is_some_and(|numbers| numbers.contains(&f32::NEG_INFINITY));
            if closes || self.is_of_nothing(node) {
                return true;
            }
            let passes = is_sum
                || node.op_is::<AxisOp>()
                || node.op_is::<Iff>()
                || node.op_is::<TypedConcat>()
                || node.op_is::<Slice>();
            if passes && seen.insert(node.id) {
                waiting.extend(&node.inputs);
            }
        }
        false
    }

    /// Whether a node is a logarithm of numbers that may be zero; sums of powers are not.
    fn is_of_nothing(&self, node: &TypedNode) -> bool {
        let is_logarithm = node.op_as::<ElementWiseOp>().is_some_and(|op| op.0.name() == "Ln");
        let is_sum = |outlet: &OutletId| self.model.node(outlet.node).op_is::<Reduce>();
        is_logarithm && !node.inputs.iter().any(is_sum)
    }

    /// The caller's next state is what stands there behind the last step.
    fn next_state(&mut self, to: Place) -> Lowered<()> {
        let index = if self.states.is_empty() { None } else { Some(self.states.remove(0)) };
        match index.and_then(|index| self.ops.get_mut(index)) {
            Some(Op::State(state)) if state.from.len == to.len => {
                state.to = to;
                Ok(())
            }
            _ => Err(CompileError::NoPolicy {
                reason: "a recurrent state comes out in another length".to_owned(),
            }),
        }
    }

    /// Adds a step that joins two values, the right one as long as the left or a single number.
    fn combine(&mut self, combination: Combination, left: Place, right: Place) -> Place {
        let to = self.arena.place(left.len as usize);
        self.ops.push(Op::Combine(Combine { combination, left, right, to }));
        to
    }

    /// Adds a function of every number.
    fn map(&mut self, function: Function, [a, b]: [f32; 2], from: Place) -> Place {
        let to = self.arena.place(from.len as usize);
        self.ops.push(Op::Map(Map { function, a: a.to_bits(), b: b.to_bits(), from, to }));
        to
    }
}
