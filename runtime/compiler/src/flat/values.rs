//! A file's inputs and outputs, as far as they are known before anything is chosen.

use std::fmt;

use sortie_plans::{CompileError, InputRole, PolicyOptions, ValueType};
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::dimension;
use tract_onnx::pb::{self, type_proto};
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::internal::*;

use crate::graph::guarded;

/// An input or output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Value {
    pub(super) name: String,
    pub(super) kind: Option<ValueType>,
    /// None where it is not known: that part of the graph may not be needed.
    pub(super) shape: Option<Vec<usize>>,
    /// Whether all that is asked of its numbers is if they are zero.
    pub(super) is_flag: bool,
}

/// The inputs and outputs of a file.
pub(super) struct Values {
    pub(super) inputs: Vec<Value>,
    pub(super) outputs: Vec<Value>,
}

impl Values {
    /// Those of a file with fixed sizes; what outputs are like follows from the graph.
    pub(super) fn of(file: &pb::ModelProto) -> Self {
        let graph = file.graph.as_ref();
        let infos = |values: fn(&pb::GraphProto) -> &[pb::ValueInfoProto]| {
            graph.map(values).unwrap_or_default().iter()
        };
        let inputs: Vec<Value> = infos(|graph| &graph.input).map(declared).collect();
        let mut outputs: Vec<Value> = infos(|graph| &graph.output).map(declared).collect();
        // What cannot be read or analysed may belong to outputs that nobody wants.
        let infer = || {
            let mut model = reader().model_for_proto_model(file)?;
            let _ = model.analyse(true);
            let outlets = model.output_outlets()?.iter();
            outlets.map(|outlet| model.outlet_fact(*outlet).cloned()).collect()
        };
        let inferred: Vec<InferenceFact> = guarded(infer).unwrap_or_default();
        for (output, fact) in outputs.iter_mut().zip(inferred) {
            output.kind = fact.datum_type.concretize().map_or(output.kind, value_type);
            output.shape =
                fact.shape.as_concrete_finite().ok().flatten().map(|shape| shape.to_vec());
        }
        Self { inputs, outputs }
    }
}

impl Value {
    /// The last of its sizes, if they are known.
    pub(super) fn last_size(&self) -> Option<usize> {
        self.shape.as_ref()?.last().copied()
    }

    pub(super) fn is_float(&self) -> bool {
        self.kind.is_some_and(ValueType::is_float)
    }

    /// Whether it has numbers that are whole.
    pub(super) fn is_whole(&self) -> bool {
        self.kind.is_some_and(|kind| kind.is_integer() || kind == ValueType::U8)
    }

    /// Type and sizes.
    pub(super) fn text(&self) -> String {
        let kind = self.kind.map_or("of unknown type", ValueType::name);
        self.shape.as_ref().map_or(kind.to_owned(), |shape| format!("{kind} {shape:?}"))
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` {}", self.name, self.text())
    }
}

/// What reads files with fixed sizes: what they note of values between may be of other ones.
pub(super) fn reader() -> tract_onnx::Onnx {
    tract_onnx::onnx().with_ignore_value_info(true)
}

/// Several things in a message.
pub(super) fn listed(things: impl Iterator<Item = String>) -> String {
    let things: Vec<String> = things.collect();
    if things.is_empty() { "none".to_owned() } else { things.join(", ") }
}

/// The type of numbers that engines are given and give.
pub(super) fn value_type(kind: DatumType) -> Option<ValueType> {
    Some(match kind {
        DatumType::F32 => ValueType::F32,
        DatumType::F64 => ValueType::F64,
        DatumType::I64 | DatumType::TDim => ValueType::I64,
        DatumType::I32 => ValueType::I32,
        DatumType::U8 => ValueType::U8,
        DatumType::Bool => ValueType::Bool,
        _ => return None,
    })
}

/// The sizes of an input or output; none where it is no tensor, or has none.
pub(super) fn dims(value: &pb::ValueInfoProto) -> Option<&[pb::tensor_shape_proto::Dimension]> {
    let type_proto::Value::TensorType(tensor) = value.r#type.as_ref()?.value.as_ref()?;
    Some(&tensor.shape.as_ref()?.dim)
}

fn declared(value: &pb::ValueInfoProto) -> Value {
    let size = |dim: &pb::tensor_shape_proto::Dimension| match dim.value {
        Some(dimension::Value::DimValue(size)) => usize::try_from(size).ok(),
        _ => None,
    };
    let shape = dims(value).and_then(|dims| dims.iter().map(size).collect());
    Value { name: value.name.clone(), kind: declared_type(value), shape, is_flag: false }
}

/// Type and sizes as the file has them.
pub(super) fn declared_text(value: &pb::ValueInfoProto) -> String {
    let size = |dim: &pb::tensor_shape_proto::Dimension| match &dim.value {
        Some(dimension::Value::DimValue(size)) => size.to_string(),
        Some(dimension::Value::DimParam(name)) if !name.is_empty() => name.clone(),
        _ => "?".to_owned(),
    };
    let kind = declared_type(value).map_or("of unknown type", ValueType::name);
    let sizes: Vec<String> = dims(value).unwrap_or_default().iter().map(size).collect();
    format!("{kind} [{}]", sizes.join(", "))
}

fn declared_type(value: &pb::ValueInfoProto) -> Option<ValueType> {
    let type_proto::Value::TensorType(tensor) = value.r#type.as_ref()?.value.as_ref()?;
    let kind = DataType::try_from(tensor.elem_type).ok()?;
    value_type(DatumType::try_from(kind).ok()?)
}

/// What says that an agent's own row comes before all others.
const FIRST: &str = "first";

/// The inputs of a network over entities, or of one that is told who it is.
pub(super) struct EntityRoles {
    rows: Option<Rows>,
    /// The input with the number of the own row; none where that comes first.
    own: Option<String>,
}

/// The entities, and which of them an agent may attend to.
struct Rows {
    entities: String,
    mask: String,
    /// Whether the mask is 1 for what must not be attended to.
    blocks: bool,
}

impl EntityRoles {
    /// Those that are said; nothing is found by itself.
    pub(super) fn of(
        inputs: &[Value],
        options: &PolicyOptions,
    ) -> Result<Option<Self>, CompileError> {
        let PolicyOptions { entities, mask, own, .. } = options;
        let Some(entities) = entities else {
            return match own.as_deref() {
                None if mask.is_none() => Ok(None),
                Some(name) if mask.is_none() && name != FIRST => {
                    let own = Some(index(inputs, name)?);
                    Ok(Some(Self { rows: None, own }))
                }
                _ => Err(no_entities(inputs)),
            };
        };
        let rows = named(inputs, "input of entities", entities)?;
        let count = rows.is_float().then(|| count(rows)).flatten();
        let count = count.ok_or_else(|| no_entities(inputs))?;
        let is_mask = |value: &&Value| numbers(value) == Some(count) && value.name != *entities;
        let (mask, blocks) = mask
            .as_deref()
            .and_then(polarity)
            .ok_or_else(|| no_mask(inputs.iter().filter(is_mask)))?;
        let mask = named(inputs, "mask of entities", mask)?;
        if !is_mask(&mask) {
            return Err(no_mask(inputs.iter().filter(is_mask)));
        }
        let own = match own.as_deref() {
            Some(FIRST) => None,
            Some(name) => Some(index(inputs, name)?),
            None => return Err(no_own(inputs)),
        };
        let rows = Rows { entities: entities.clone(), mask: mask.name.clone(), blocks };
        Ok(Some(Self { rows: Some(rows), own }))
    }

    /// What an input is for, where it is one of these.
    pub(super) fn role(&self, name: &str) -> Option<InputRole> {
        let own_first = self.own.is_none();
        match &self.rows {
            _ if self.own.as_deref() == Some(name) => Some(InputRole::OwnIndex),
            Some(rows) if name == rows.entities => Some(InputRole::Entities { own_first }),
            Some(rows) if name == rows.mask => {
                Some(InputRole::Mask { blocks: rows.blocks, own_first })
            }
            _ => None,
        }
    }
}

/// The name of a mask, and whether it is 1 for what must not be attended to.
fn polarity(said: &str) -> Option<(&str, bool)> {
    let visible = said.strip_suffix(":visible").map(|name| (name, false));
    visible.or_else(|| said.strip_suffix(":blocked").map(|name| (name, true)))
}

/// How many entities there are in `[.., N, D]`.
fn count(value: &Value) -> Option<usize> {
    let shape = value.shape.as_ref()?;
    let (count, rows) = (shape.iter().rev().nth(1)?, shape.iter().rev().skip(2));
    rows.copied().all(|size| size == 1).then_some(*count)
}

/// The input with the number of the own row.
fn index(inputs: &[Value], name: &str) -> Result<String, CompileError> {
    let own = named(inputs, "number of the own row", name)?;
    if is_index(&own) { Ok(own.name.clone()) } else { Err(no_own(inputs)) }
}

fn is_index(value: &&Value) -> bool {
    value.is_whole() && numbers(value) == Some(1)
}

fn numbers(value: &Value) -> Option<usize> {
    value.shape.as_ref().map(|shape| shape.iter().product())
}

fn named<'v>(
    inputs: &'v [Value],
    what: &'static str,
    name: &str,
) -> Result<&'v Value, CompileError> {
    let found = inputs.iter().find(|input| input.name == name);
    found.ok_or_else(|| CompileError::NotInFile {
        what: what.into(),
        name: name.to_owned(),
        found: listed(inputs.iter().map(ToString::to_string)),
    })
}

fn no_entities(inputs: &[Value]) -> CompileError {
    let candidates = inputs.iter().filter(|input| input.is_float() && count(input).is_some());
    CompileError::Unclear {
        what: "which input holds the entities [1, N, D]".into(),
        candidates: listed(candidates.map(ToString::to_string)),
        flag: "`--entities NAME`".into(),
    }
}

fn no_mask<'v>(candidates: impl Iterator<Item = &'v Value>) -> CompileError {
    CompileError::Unclear {
        what: "which entities an agent may attend to".into(),
        candidates: listed(candidates.map(ToString::to_string)),
        flag: "`--mask NAME:visible` where 1 is what it may attend to, `--mask NAME:blocked` where 0 is".into(),
    }
}

fn no_own(inputs: &[Value]) -> CompileError {
    let candidates = inputs.iter().filter(is_index);
    CompileError::Unclear {
        what: "which entity the agent itself is".into(),
        candidates: listed(candidates.map(ToString::to_string)),
        flag: "`--self first` where its own row comes first, or `--self NAME` of the input with its number".into(),
    }
}
