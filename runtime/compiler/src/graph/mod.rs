//! The graph of an ONNX file as tract simplifies it, and what the matcher asks of it.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Arc;

use tract_onnx::pb;
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_hir::internal::DimLike;

use sortie_plans::CompileError;

/// A network with the inputs and outputs of an agent, of an allocator, or over all entities.
#[derive(Debug)]
pub(crate) struct Graph {
    /// The file as it is.
    pub(crate) file: pb::ModelProto,
    /// The same, simplified.
    pub(crate) model: TypedModel,
    pub(crate) inputs: Inputs,
    /// Metadata of the file.
    pub(crate) metadata: BTreeMap<String, String>,
    /// Columns D of the rows that are embedded.
    pub(crate) columns: usize,
    /// Width of the answer: actions U, or one value.
    pub(crate) actions: usize,
    /// What the network answers: an agent's utilities, an allocator's value, one output of several.
    pub(crate) answer: OutletId,
}

/// What kind of network it is, and which input of the graph is what.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Inputs {
    Agent(Roles),
    TeamValue(TeamRoles),
    Entities(EntityRoles),
    Proposals(ProposalRoles),
}

/// Which input of an agent's graph is what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Roles {
    pub(crate) entities: usize,
    pub(crate) self_index: usize,
    pub(crate) visible: usize,
    pub(crate) memory: Option<Memory>,
}

/// Which input and output of an agent's graph is its recurrent state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Memory {
    /// The input, by place.
    pub(crate) input: usize,
    /// The output, by place.
    pub(crate) output: usize,
    /// Floats R of the state.
    pub(crate) size: usize,
}

/// Which input of a team-value graph is what, and the columns of its rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TeamRoles {
    pub(crate) entities: usize,
    pub(crate) present: usize,
    pub(crate) is_agent: usize,
    pub(crate) in_task: usize,
    pub(crate) open: usize,
    pub(crate) team: usize,
    pub(crate) relation: usize,
    /// Features d.
    pub(crate) features: usize,
    /// Columns F of the relation.
    pub(crate) relations: usize,
}

/// Which input of a network over all entities is what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EntityRoles {
    pub(crate) entities: usize,
    pub(crate) present: usize,
    pub(crate) is_agent: Option<usize>,
    pub(crate) groups: Option<usize>,
    /// Columns T of the groups, 0 where there are none.
    pub(crate) group_count: usize,
}

/// A part of an allocator that proposes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ProposalPart {
    Trunk,
    Step,
    Critic,
}

impl ProposalPart {
    /// Whose network it is, in messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Trunk => "a proposing allocator's trunk",
            Self::Step => "a proposing allocator's step",
            Self::Critic => "a proposing allocator's critic",
        }
    }
}

/// Which input of a part of an allocator that proposes is what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProposalRoles {
    pub(crate) part: ProposalPart,
    /// Entities `[N, d]`, or the subtasks' embeddings `[T, E]`.
    pub(crate) entities: usize,
    /// The subtasks of every entity `[N, T]`, or their entities `[T]`.
    pub(crate) groups: usize,
    /// Who exists `[N]`, or which subtasks are open `[T]`.
    pub(crate) present: usize,
    /// Who is an agent `[N]`, or the embedding `[E]` of the one that chooses.
    pub(crate) agent: usize,
    /// Agents of every subtask `[T]`, of the step.
    pub(crate) counts: usize,
    /// Subtasks T.
    pub(crate) tasks: usize,
}

impl Graph {
    /// Reads an ONNX file and finds its inputs: an agent's by type and shape, those of others by name.
    pub(crate) fn read(onnx: &[u8]) -> Result<Self, CompileError> {
        let (file, model, metadata) = guarded(|| {
            let onnx_reader = tract_onnx::onnx();
            let file = onnx_reader.proto_model_for_read(&mut &*onnx)?;
            let entries = file.metadata_props.iter();
            let metadata = entries.map(|entry| (entry.key.clone(), entry.value.clone())).collect();
            let model = onnx_reader.model_for_proto_model(&file)?;
            let model = model.into_typed()?.into_decluttered()?;
            Ok((file, model, metadata))
        })
        .map_err(|reason| CompileError::Unreadable { reason })?;
        let inputs: Vec<TypedFact> = facts(&model, &model.inputs);
        let found = team_roles(&model, &inputs)
            .map(|roles| (Inputs::TeamValue(roles), roles.features + 2 + roles.relations))
            .or_else(|| {
                let roles = proposal_roles(&model, &inputs)?;
                Some((Inputs::Proposals(roles), fixed(inputs.get(roles.entities)?, 1)?))
            })
            .or_else(|| {
                let roles = entity_roles(&model, &inputs)?;
                Some((Inputs::Entities(roles), fixed(inputs.get(roles.entities)?, 1)?))
            })
            .or_else(|| {
                let roles = roles(&model, &inputs)?;
                Some((Inputs::Agent(roles), fixed(inputs.get(roles.entities)?, 1)?))
            });
        let answer = answer(&model);
        let actions = answer.and_then(|answer| last_dim(model.outlet_fact(answer).ok()?));
        let (Some((inputs, columns)), Some(answer), Some(actions)) = (found, answer, actions)
        else {
            return Err(CompileError::Inputs { found: describe_inputs(&model) });
        };
        Ok(Self { file, model, inputs, metadata, columns, actions, answer })
    }

    /// The inputs of an agent's graph.
    pub(crate) fn agent_roles(&self) -> Result<Roles, CompileError> {
        match self.inputs {
            Inputs::Agent(roles) => Ok(roles),
            _ => Err(CompileError::OtherNetwork { want: "an agent's".into() }),
        }
    }

    /// The inputs of an allocator's graph.
    pub(crate) fn team_roles(&self) -> Result<TeamRoles, CompileError> {
        match self.inputs {
            Inputs::TeamValue(roles) => Ok(roles),
            _ => Err(CompileError::OtherNetwork { want: "an allocator's".into() }),
        }
    }

    /// The inputs of a graph over all entities.
    pub(crate) fn entity_roles(&self) -> Result<EntityRoles, CompileError> {
        match self.inputs {
            Inputs::Entities(roles) => Ok(roles),
            _ => Err(CompileError::OtherNetwork { want: "an all-entities".into() }),
        }
    }

    /// The inputs of a part of an allocator that proposes.
    pub(crate) fn proposal_roles(&self) -> Result<ProposalRoles, CompileError> {
        match self.inputs {
            Inputs::Proposals(roles) => Ok(roles),
            _ => Err(CompileError::OtherNetwork { want: "a proposing allocator's".into() }),
        }
    }

    /// A whole number of the file's metadata.
    pub(crate) fn number(&self, key: &str) -> Option<usize> {
        self.metadata.get(key)?.parse().ok()
    }

    /// The outlet that `outlet` only reshapes or reorders.
    pub(crate) fn source(&self, outlet: OutletId) -> OutletId {
        source(&self.model, outlet)
    }

    /// The node that computes `outlet`, reshaping left out.
    pub(crate) fn node(&self, outlet: OutletId) -> &TypedNode {
        self.model.node(self.source(outlet).node)
    }

    /// The name of the input at `index`.
    pub(crate) fn input_name(&self, index: usize) -> String {
        self.input(index)
            .map(|outlet| self.model.node(outlet.node).name.clone())
            .unwrap_or_default()
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

    /// The operands of a binary operator.
    pub(crate) fn operands(&self, outlet: OutletId, operator: &str) -> Option<[OutletId; 2]> {
        let node = self.node(outlet);
        let binary = node.op_as::<TypedBinOp>()?;
        let &[a, b] = node.inputs.as_slice() else { return None };
        (binary.0.name() == operator).then_some([a, b])
    }

    /// The operands of a binary operator: what varies, and the constant.
    pub(crate) fn with_constant(&self, outlet: OutletId, operator: &str) -> Option<[OutletId; 2]> {
        let [a, b] = self.operands(outlet, operator)?;
        match (self.constant(a), self.constant(b)) {
            (None, Some(_)) => Some([a, b]),
            (Some(_), None) => Some([b, a]),
            _ => None,
        }
    }

    /// The error that names the node behind `outlet`.
    pub(crate) fn unsupported(&self, outlet: OutletId, hint: &'static str) -> CompileError {
        unsupported(&self.model, self.node(outlet), hint)
    }
}

/// The error that names a node.
pub(crate) fn unsupported(
    model: &TypedModel,
    node: &TypedNode,
    hint: &'static str,
) -> CompileError {
    let facts = model.node_input_facts(node.id).unwrap_or_default();
    let shapes: Vec<String> = facts.iter().map(|fact| shape(fact)).collect();
    CompileError::Unsupported {
        node: node.name.clone(),
        operator: node.op.name().into_owned(),
        shapes: shapes.join(", "),
        hint: hint.into(),
    }
}

thread_local! {
    static IS_GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Has panics of the ONNX reader, which become errors with its reason, print nothing of their own in this process.
pub fn silence_guarded_panics() {
    let usual = take_hook();
    set_hook(Box::new(move |panic| {
        if !IS_GUARDED.get() {
            usual(panic);
        }
    }));
}

/// Runs tract, whose analysis can panic on damaged files, and gives its reason as text.
pub(crate) fn guarded<T>(work: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    let outer = IS_GUARDED.replace(true);
    let done = catch_unwind(AssertUnwindSafe(work));
    IS_GUARDED.set(outer);
    match done {
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

fn facts(model: &TypedModel, outlets: &[OutletId]) -> Vec<TypedFact> {
    outlets.iter().filter_map(|&outlet| model.outlet_fact(outlet).ok().cloned()).collect()
}

fn roles(model: &TypedModel, inputs: &[TypedFact]) -> Option<Roles> {
    let only = |wanted: DatumType, rank| {
        let fits = |fact: &TypedFact| fact.datum_type == wanted && fact.rank() == rank;
        let mut found = inputs.iter().enumerate().filter(|(_, fact)| fits(fact));
        found.next().filter(|_| found.next().is_none()).map(|(index, _)| index)
    };
    let state = only(f32::datum_type(), 1);
    Some(Roles {
        entities: only(f32::datum_type(), 2)?,
        self_index: only(i64::datum_type(), 1)?,
        visible: only(bool::datum_type(), 1)?,
        memory: match state {
            Some(input) => Some(memory(model, input, fixed(inputs.get(input)?, 0)?)?),
            None => None,
        },
    })
}

/// The state that goes in at `input` comes out where the utilities, the other output, are computed from.
fn memory(model: &TypedModel, input: usize, size: usize) -> Option<Memory> {
    let answer = answer(model)?;
    let output = model.outputs.iter().position(|outlet| *outlet != answer)?;
    let fact = model.outlet_fact(*model.outputs.get(output)?).ok()?;
    (fact.datum_type == f32::datum_type() && last_dim(fact) == Some(size)).then_some(Memory {
        input,
        output,
        size,
    })
}

/// The output that no other is computed from; the last one where several are.
fn answer(model: &TypedModel) -> Option<OutletId> {
    let feeds = |outlet: &OutletId| {
        let source = source(model, *outlet);
        let others = model.outputs.iter().filter(|other| *other != outlet);
        others.clone().any(|other| is_computed_from(model, *other, source))
    };
    model.outputs.iter().rev().find(|outlet| !feeds(outlet)).copied()
}

/// Whether `source` is among what `outlet` is computed from.
fn is_computed_from(model: &TypedModel, outlet: OutletId, source: OutletId) -> bool {
    let (mut seen, mut open) = (vec![false; model.nodes.len()], vec![outlet]);
    while let Some(outlet) = open.pop() {
        if outlet == source {
            return true;
        }
        let is_new = seen.get_mut(outlet.node).is_some_and(|seen| !std::mem::replace(seen, true));
        if let Some(node) = model.nodes.get(outlet.node).filter(|_| is_new) {
            open.extend(&node.inputs);
        }
    }
    false
}

/// The outlet that `outlet` only reshapes or reorders.
fn source(model: &TypedModel, mut outlet: OutletId) -> OutletId {
    while let Some(node) = model.nodes.get(outlet.node)
        && node.op_is::<AxisOp>()
        && let Some(&input) = node.inputs.first()
    {
        outlet = input;
    }
    outlet
}

fn last_dim(fact: &TypedFact) -> Option<usize> {
    fixed(fact, fact.rank().checked_sub(1)?)
}

/// The place of an input of this name, type and rank.
fn named(
    model: &TypedModel,
    inputs: &[TypedFact],
    name: &str,
    (kind, rank): (DatumType, usize),
) -> Option<usize> {
    let place = model.inputs.iter().position(|input| model.node(input.node).name == name)?;
    let fact = inputs.get(place)?;
    (fact.datum_type == kind && fact.rank() == rank).then_some(place)
}

fn entity_roles(model: &TypedModel, inputs: &[TypedFact]) -> Option<EntityRoles> {
    let mask = |name, rank| named(model, inputs, name, (bool::datum_type(), rank));
    let (is_agent, groups) = (mask("is_agent", 1), mask("groups", 2));
    let roles = EntityRoles {
        entities: named(model, inputs, "entities", (f32::datum_type(), 2))?,
        present: mask("present", 1)?,
        is_agent,
        groups,
        group_count: groups.map_or(Some(0), |groups| fixed(inputs.get(groups)?, 1))?,
    };
    let known = 2 + usize::from(is_agent.is_some()) + usize::from(groups.is_some());
    (inputs.len() == known).then_some(roles)
}

fn proposal_roles(model: &TypedModel, inputs: &[TypedFact]) -> Option<ProposalRoles> {
    let mask = |name| named(model, inputs, name, (bool::datum_type(), 1));
    let floats = |name, rank| named(model, inputs, name, (f32::datum_type(), rank));
    let size = |place: usize, axis| fixed(inputs.get(place)?, axis);
    if let Some(agent) = floats("agent_embedding", 1) {
        let entities = floats("task_embedding", 2)?;
        return Some(ProposalRoles {
            part: ProposalPart::Step,
            entities,
            groups: floats("task_count", 1)?,
            present: mask("task_open")?,
            agent,
            counts: floats("agent_count", 1)?,
            tasks: size(entities, 0)?,
        });
    }
    let groups = floats("entity_task", 2)?;
    Some(ProposalRoles {
        part: if model.outputs.len() == 1 { ProposalPart::Critic } else { ProposalPart::Trunk },
        entities: floats("entities", 2)?,
        groups,
        present: mask("present")?,
        agent: mask("is_agent")?,
        counts: groups,
        tasks: size(groups, 1)?,
    })
}

fn team_roles(model: &TypedModel, inputs: &[TypedFact]) -> Option<TeamRoles> {
    let mask = |name| named(model, inputs, name, (bool::datum_type(), 1));
    let rows = |name| named(model, inputs, name, (f32::datum_type(), 2));
    let (entities, relation) = (rows("entities")?, rows("relation")?);
    Some(TeamRoles {
        entities,
        present: mask("present")?,
        is_agent: mask("is_agent")?,
        in_task: mask("in_task")?,
        open: mask("open")?,
        team: mask("team")?,
        relation,
        features: fixed(inputs.get(entities)?, 1)?,
        relations: fixed(inputs.get(relation)?, 1)?,
    })
}

fn fixed(fact: &TypedFact, axis: usize) -> Option<usize> {
    fact.shape.get(axis)?.to_usize().ok()
}
