//! Loops as the steps that they take, branches as both of their ways: plans run from their first step to their last.

use std::collections::HashMap;

use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{Slice, TypedConcat};
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_core::ops::einsum::EinSum;
use tract_onnx::tract_core::ops::gru_cell::GruEpilogue;
use tract_onnx::tract_core::ops::gru_seq::GruSeq;
use tract_onnx::tract_core::ops::konst::Const;
use tract_onnx::tract_core::ops::logic::{IfThenElse, Iff};
use tract_onnx::tract_core::ops::math::add;
use tract_onnx::tract_core::ops::scan::{InputMapping, Scan, ScanInfo};
use tract_onnx::tract_core::ops::source::TypedSource;
use tract_onnx::tract_hir::internal::*;

/// The most turns of a loop that become steps.
pub(super) const TURNS: usize = 128;

/// A graph with its loops and branches laid open, as far as it is known how often a loop turns.
pub(super) fn unrolled(model: TypedModel) -> TractResult<TypedModel> {
    let opens = |node: &TypedNode| {
        node.op_is::<Scan>() || node.op_is::<GruSeq>() || node.op_is::<IfThenElse>()
    };
    if !model.nodes.iter().any(opens) {
        return Ok(model);
    }
    let mut open = Open { target: TypedModel::default() };
    open.target.symbols = model.symbols.clone();
    let mut places = Places::new();
    for outlet in &model.inputs {
        let fact = model.outlet_fact(*outlet)?.clone();
        let name = model.node(outlet.node).name.clone();
        places.insert(*outlet, open.target.add_source(name, fact)?);
    }
    let outputs = open.wire(&model, "", places)?;
    open.target.select_output_outlets(&outputs)?;
    Ok(open.target)
}

/// Where the values of a graph stand in the one that is laid open.
type Places = HashMap<OutletId, OutletId>;

/// The graph that is laid open.
struct Open {
    target: TypedModel,
}

impl Open {
    /// Adds the nodes of a graph whose inputs have their places; gives its outputs.
    fn wire(
        &mut self,
        model: &TypedModel,
        prefix: &str,
        mut places: Places,
    ) -> TractResult<Vec<OutletId>> {
        for id in model.eval_order()? {
            let node = model.node(id);
            if node.op_is::<TypedSource>() {
                continue;
            }
            let inputs = node.inputs.iter().map(|outlet| placed(&places, *outlet));
            let inputs = inputs.collect::<TractResult<Vec<_>>>()?;
            let outlets = self.node(node, &format!("{prefix}{}", node.name), &inputs)?;
            for (slot, outlet) in outlets.into_iter().enumerate() {
                places.insert(OutletId::new(id, slot), outlet);
            }
        }
        model.outputs.iter().map(|outlet| placed(&places, *outlet)).collect()
    }

    fn node(
        &mut self,
        node: &TypedNode,
        name: &str,
        inputs: &[OutletId],
    ) -> TractResult<Vec<OutletId>> {
        if let Some(konst) = node.op_as::<Const>() {
            return Ok(vec![self.target.add_const(name, Arc::clone(konst.val()))?]);
        }
        if let Some(scan) = node.op_as::<Scan>()
            && let Some(turns) = self.turns(scan, inputs)?
        {
            return self.scan(scan, name, inputs, turns, node.outputs.len());
        }
        if let Some(sequence) = node.op_as::<GruSeq>()
            && let Some(turns) = self.length(inputs, 1)?.filter(|turns| *turns <= TURNS)
            && !sequence.projected
        {
            return self.sequence(sequence, name, inputs, turns);
        }
        if let Some(branch) = node.op_as::<IfThenElse>()
            && self.target.outlet_fact(inputs[0])?.konst.is_none()
        {
            return self.branch(branch, name, inputs);
        }
        let mut op = node.op.clone();
        // ONNX has no memory of its own: every run begins with the state that goes in.
        if let Some(scan) = op.downcast_mut::<Scan>() {
            scan.reset_every_turn = true;
        }
        if let Some(sequence) = op.downcast_mut::<GruSeq>() {
            sequence.reset_every_turn = true;
        }
        let name = self.target.unique_name(name).into_owned();
        Ok(self.target.wire_node(name, op, inputs)?.into_iter().collect())
    }

    /// How often a loop turns, where it becomes steps.
    fn turns(&self, scan: &Scan, inputs: &[OutletId]) -> TractResult<Option<usize>> {
        let facts = inputs.iter().map(|outlet| self.target.outlet_fact(*outlet));
        let facts = facts.collect::<TractResult<Vec<_>>>()?;
        let turns = scan.iteration_count(&facts).and_then(|turns| turns.to_usize().ok());
        let mut parts = scan.input_mapping.iter().zip(&facts).filter_map(|(mapping, fact)| {
            let info = mapping.as_scan()?;
            Some((info.chunk, fact.shape[info.axis].to_usize().ok()?))
        });
        let is_whole = |(chunk, size): (isize, usize)| {
            chunk == -1 || chunk > 0 && size.is_multiple_of(chunk.unsigned_abs())
        };
        let is_plain = scan.skip == 0 && parts.all(is_whole);
        Ok(turns.filter(|turns| is_plain && (1..=TURNS).contains(turns)))
    }

    fn length(&self, inputs: &[OutletId], axis: usize) -> TractResult<Option<usize>> {
        let fact = self.target.outlet_fact(inputs[0])?;
        Ok(fact.shape.get(axis).and_then(|size| size.to_usize().ok()))
    }

    /// The turns of a loop one behind the other.
    fn scan(
        &mut self,
        scan: &Scan,
        name: &str,
        inputs: &[OutletId],
        turns: usize,
        outputs: usize,
    ) -> TractResult<Vec<OutletId>> {
        let given = scan.input_mapping.iter().zip(inputs);
        let mut states: Vec<OutletId> =
            given.filter(|(mapping, _)| mapping.is_state()).map(|(_, outlet)| *outlet).collect();
        let mut all: Vec<Vec<OutletId>> = Vec::new();
        for turn in 0..turns {
            let prefix = format!("{name}.{turn}.");
            let mut next = states.iter().copied();
            let mut places = Places::new();
            for ((mapping, given), inner) in
                scan.input_mapping.iter().zip(inputs).zip(&scan.body.inputs)
            {
                let outlet = match mapping {
                    InputMapping::Full => *given,
                    InputMapping::State => next.next().context("a state")?,
                    InputMapping::Scan(info) => self.part(*given, info, &prefix, turn, turns)?,
                };
                places.insert(*inner, outlet);
            }
            let results = self.wire(&scan.body, &prefix, places)?;
            let kept = results.iter().zip(&scan.output_mapping).filter(|(_, kept)| kept.state);
            states = kept.map(|(outlet, _)| *outlet).collect();
            all.push(results);
        }
        let mut outlets = vec![None; outputs];
        for (index, mapping) in scan.output_mapping.iter().enumerate() {
            let of_turns = all.iter().map(|results| results[index]).collect::<Vec<_>>();
            if let Some((slot, info)) = mapping.scan {
                outlets[slot] = Some(self.joined(of_turns.clone(), info, name)?);
            }
            if let Some(slot) = mapping.last_value_slot {
                outlets[slot] = of_turns.last().copied();
            }
        }
        outlets.into_iter().collect::<Option<_>>().context("a loop gives all of its outputs")
    }

    /// What a loop is given in one of its turns.
    fn part(
        &mut self,
        given: OutletId,
        info: &ScanInfo,
        prefix: &str,
        turn: usize,
        turns: usize,
    ) -> TractResult<OutletId> {
        let size = info.chunk.unsigned_abs();
        let turn = if info.chunk < 0 { turns - 1 - turn } else { turn };
        let slice = Slice::new(info.axis, turn * size, (turn + 1) * size);
        self.one(&format!("{prefix}part"), slice, &[given])
    }

    /// What a loop gives in all of its turns.
    fn joined(
        &mut self,
        mut turns: Vec<OutletId>,
        info: ScanInfo,
        name: &str,
    ) -> TractResult<OutletId> {
        if info.chunk < 0 {
            turns.reverse();
        }
        self.one(&format!("{name}.all"), TypedConcat { axis: info.axis }, &turns)
    }

    /// A gated recurrent unit over a sequence `[batch, turns, inputs]`, its turns one behind the other.
    fn sequence(
        &mut self,
        unit: &GruSeq,
        name: &str,
        inputs: &[OutletId],
        turns: usize,
    ) -> TractResult<Vec<OutletId>> {
        let gates = 3 * unit.hidden;
        let &[given, weights, recurrent, .., first] = inputs else { bail!("a unit has weights") };
        let mut biases = Vec::new();
        if unit.has_bias {
            for (part, start) in [("input", 0), ("state", gates)] {
                let slice = Slice::new(1, start, start + gates);
                biases.push(self.one(&format!("{name}.bias.{part}"), slice, &inputs[3..4])?);
            }
        }
        let mut state = self.one(&format!("{name}.first"), AxisOp::Rm(1), &[first])?;
        let info = ScanInfo::new(1, unit.chunk);
        let mut all = Vec::new();
        for turn in 0..turns {
            let prefix = format!("{name}.{turn}.");
            let part = self.part(given, &info, &prefix, turn, turns)?;
            let part = self.one(&format!("{prefix}row"), AxisOp::Rm(1), &[part])?;
            let input = self.product([part, weights], biases.first(), &format!("{prefix}input"))?;
            let kept = self.product([state, recurrent], biases.get(1), &format!("{prefix}kept"))?;
            let cell = GruEpilogue { hidden: unit.hidden };
            state = self.one(&format!("{prefix}cell"), cell, &[input, kept, state])?;
            all.push(self.one(&format!("{prefix}state"), AxisOp::Add(1), &[state])?);
        }
        let last = all.last().copied().context("a turn")?;
        Ok(vec![self.joined(all, info, name)?, last])
    }

    /// Rows times a matrix of columns, and a bias.
    fn product(
        &mut self,
        factors: [OutletId; 2],
        bias: Option<&OutletId>,
        name: &str,
    ) -> TractResult<OutletId> {
        let product = EinSum::new("bi,gi->bg".parse()?, f32::datum_type());
        let product = self.one(name, product, &factors)?;
        bias.map_or(Ok(product), |bias| self.one(&format!("{name}.sum"), add(), &[product, *bias]))
    }

    /// Both ways of a branch, and what its condition takes of them.
    fn branch(
        &mut self,
        branch: &IfThenElse,
        name: &str,
        inputs: &[OutletId],
    ) -> TractResult<Vec<OutletId>> {
        let mut ways = Vec::new();
        for (way, body, mapping) in [
            ("then", &branch.then_body, &branch.then_input_mapping),
            ("else", &branch.else_body, &branch.else_input_mapping),
        ] {
            let given = body.inputs.iter().zip(mapping).map(|(inner, at)| (*inner, inputs[*at]));
            ways.push(self.wire(body, &format!("{name}.{way}."), given.collect())?);
        }
        let mut outlets = Vec::new();
        for (index, (yes, no)) in ways[0].iter().zip(&ways[1]).enumerate() {
            let rank = self.target.outlet_fact(*yes)?.rank();
            let mut condition = inputs[0];
            while self.target.outlet_fact(condition)?.rank() < rank {
                let axis = AxisOp::Add(0);
                condition = self.one(&format!("{name}.{index}.condition"), axis, &[condition])?;
            }
            let choice = [condition, *yes, *no];
            outlets.push(self.one(&format!("{name}.{index}.choice"), Iff, &choice)?);
        }
        Ok(outlets)
    }

    /// Adds a node of one output.
    fn one(
        &mut self,
        name: &str,
        op: impl Into<Box<dyn TypedOp>>,
        inputs: &[OutletId],
    ) -> TractResult<OutletId> {
        let name = self.target.unique_name(name).into_owned();
        let outlets = self.target.wire_node(name, op, inputs)?;
        outlets.first().copied().context("a node has an output")
    }
}

fn placed(places: &Places, outlet: OutletId) -> TractResult<OutletId> {
    places.get(&outlet).copied().context("what is read is there")
}
