//! The graph of an ONNX file as tract simplifies it, and what the matcher asks of it.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_hir::internal::DimLike;

use crate::error::CompileError;

/// A network with the inputs and outputs of an agent.
#[derive(Debug)]
pub(crate) struct Graph {
    pub(crate) model: TypedModel,
    pub(crate) roles: Roles,
    /// Metadata of the file.
    pub(crate) metadata: BTreeMap<String, String>,
    /// Columns D of the entities.
    pub(crate) columns: usize,
    /// Actions U.
    pub(crate) actions: usize,
}

/// Which input of the graph is what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Roles {
    pub(crate) entities: usize,
    pub(crate) self_index: usize,
    pub(crate) visible: usize,
}

impl Graph {
    /// Reads an ONNX file and finds its inputs by type and shape.
    pub(crate) fn read(onnx: &[u8]) -> Result<Self, CompileError> {
        let (model, metadata) = guarded(|| {
            let onnx_reader = tract_onnx::onnx();
            let file = onnx_reader.proto_model_for_read(&mut &*onnx)?;
            let entries = file.metadata_props.iter();
            let metadata = entries.map(|entry| (entry.key.clone(), entry.value.clone())).collect();
            let model = onnx_reader.model_for_proto_model(&file)?;
            Ok((model.into_typed()?.into_decluttered()?, metadata))
        })
        .map_err(|reason| CompileError::Unreadable { reason })?;
        let facts = |outlets: &[OutletId]| -> Vec<TypedFact> {
            outlets.iter().filter_map(|&outlet| model.outlet_fact(outlet).ok().cloned()).collect()
        };
        let inputs = facts(&model.inputs);
        let roles = roles(&inputs);
        let columns = roles.and_then(|roles| fixed(inputs.get(roles.entities)?, 1));
        let actions = facts(&model.outputs).last().and_then(|fact| fixed(fact, fact.rank() - 1));
        let (Some(roles), Some(columns), Some(actions)) = (roles, columns, actions) else {
            return Err(CompileError::Inputs { found: describe_inputs(&model) });
        };
        Ok(Self { model, roles, metadata, columns, actions })
    }

    /// A whole number of the file's metadata.
    pub(crate) fn number(&self, key: &str) -> Option<usize> {
        self.metadata.get(key)?.parse().ok()
    }

    /// The outlet that `outlet` only reshapes or reorders.
    pub(crate) fn source(&self, mut outlet: OutletId) -> OutletId {
        while let Some(node) = self.model.nodes.get(outlet.node)
            && node.op_is::<AxisOp>()
            && let Some(&input) = node.inputs.first()
        {
            outlet = input;
        }
        outlet
    }

    /// The node that computes `outlet`, reshaping left out.
    pub(crate) fn node(&self, outlet: OutletId) -> &TypedNode {
        self.model.node(self.source(outlet).node)
    }

    /// The input of the graph at `index`.
    pub(crate) fn input(&self, index: usize) -> Option<OutletId> {
        self.model.inputs.get(index).copied()
    }

    /// The value of `outlet` if it is constant f32.
    pub(crate) fn constant(&self, outlet: OutletId) -> Option<Arc<Tensor>> {
        let constant = self.model.outlet_fact(outlet).ok()?.konst.clone()?;
        (constant.datum_type() == f32::datum_type()).then_some(constant)
    }

    /// The number that a constant repeats.
    pub(crate) fn uniform(&self, outlet: OutletId) -> Option<f32> {
        let constant = self.constant(outlet)?;
        let view = constant.to_plain_array_view::<f32>().ok()?;
        let first = *view.first()?;
        view.iter().all(|value| *value == first).then_some(first)
    }

    /// The operands of a binary operator: what varies, and the constant.
    pub(crate) fn with_constant(&self, outlet: OutletId, operator: &str) -> Option<[OutletId; 2]> {
        let node = self.node(outlet);
        let binary = node.op_as::<TypedBinOp>()?;
        let &[a, b] = node.inputs.as_slice() else { return None };
        if binary.0.name() != operator {
            return None;
        }
        match (self.constant(a), self.constant(b)) {
            (None, Some(_)) => Some([a, b]),
            (Some(_), None) => Some([b, a]),
            _ => None,
        }
    }

    /// The error that names the node behind `outlet`.
    pub(crate) fn unsupported(&self, outlet: OutletId, hint: &'static str) -> CompileError {
        let node = self.node(outlet);
        let facts = self.model.node_input_facts(node.id).unwrap_or_default();
        let shapes: Vec<String> = facts.iter().map(|fact| shape(fact)).collect();
        CompileError::Unsupported {
            node: node.name.clone(),
            operator: node.op.name().into_owned(),
            shapes: shapes.join(", "),
            hint,
        }
    }
}

/// Runs tract, whose analysis can panic on damaged files, and gives its reason as text.
pub(crate) fn guarded<T>(work: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(format!("{error:#}")),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
            Err(format!("the reader gave up: {}", text.unwrap_or("no reason given")))
        }
    }
}

/// Type and shape of a value, as messages show it.
pub(crate) fn shape(fact: &TypedFact) -> String {
    let dims: Vec<String> = fact.shape.iter().map(|dim| dim.to_string()).collect();
    let kind = format!("{:?}", fact.datum_type).to_lowercase();
    format!("{kind} [{}]", dims.join(", "))
}

fn describe_inputs(model: &TypedModel) -> String {
    let describe = |&outlet: &OutletId| {
        let fact = model.outlet_fact(outlet).map(shape).unwrap_or_default();
        format!("`{}` {fact}", model.node(outlet.node).name)
    };
    let inputs: Vec<String> = model.inputs.iter().map(describe).collect();
    if inputs.is_empty() { "no inputs".to_owned() } else { inputs.join(", ") }
}

fn roles(inputs: &[TypedFact]) -> Option<Roles> {
    let only = |matches: &dyn Fn(&TypedFact) -> bool| {
        let mut found = inputs.iter().enumerate().filter(|(_, fact)| matches(fact));
        found.next().filter(|_| found.next().is_none()).map(|(index, _)| index)
    };
    let kind = |fact: &TypedFact, kind, rank| fact.datum_type == kind && fact.rank() == rank;
    Some(Roles {
        entities: only(&|fact| kind(fact, f32::datum_type(), 2))?,
        self_index: only(&|fact| kind(fact, i64::datum_type(), 1))?,
        visible: only(&|fact| kind(fact, bool::datum_type(), 1))?,
    })
}

fn fixed(fact: &TypedFact, axis: usize) -> Option<usize> {
    fact.shape.get(axis)?.to_usize().ok()
}
