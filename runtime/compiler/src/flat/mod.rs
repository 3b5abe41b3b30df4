//! Policies whoever exported them: a file's wanted outputs, what they are computed from, and what is what in it.
//!
//! Everything is decided on the file itself. What the wanted outputs do not need is cut away before tract analyses it,
//! and the same cut file is what engines run.

mod apart;
mod facts;
mod finite;
mod misread;
mod nodes;
mod normaliser;
mod prepared;
mod remarks;
mod selection;
#[cfg(test)]
mod tests;
mod unrolled;
mod values;

use sortie_plans::{CompileError, PolicyOptions};
use tract_onnx::pb;
use tract_onnx::prelude::*;

use crate::graph::guarded;
use nodes::cut;
use selection::Selection;
use values::{Value, Values, reader};

pub(crate) use facts::{Interface, other_values};
pub(crate) use finite::wild_constant;
pub(crate) use normaliser::normaliser;
pub(crate) use remarks::remarks;

/// A policy, read.
#[derive(Debug)]
pub(crate) struct FlatGraph {
    /// The part of the file that is needed, sizes fixed, nodes as they stand in it: what the truth is computed from.
    pub(crate) source: pb::ModelProto,
    /// The same, some nodes taken apart for tract.
    pub(crate) file: pb::ModelProto,
    /// The same, simplified.
    pub(crate) model: TypedModel,
    pub(crate) interface: Interface,
    /// Names of sizes that were taken for the batch, each with an input that it leads.
    batches: Vec<(String, String)>,
}

impl FlatGraph {
    /// Reads a file and finds what is what in it.
    pub(crate) fn read(onnx: &[u8], options: &PolicyOptions) -> Result<Self, CompileError> {
        let (source, batches) = fixed(onnx, options)?;
        let (file, values) = taken_apart(&source);
        let selection = Selection::of(&file, &values, options)?;
        let outputs = selection.outputs();
        let file = cut(&file, &outputs);
        file.graph.as_ref().map_or(Ok(()), misread::refuse)?;
        file.graph.as_ref().map_or(Ok(()), finite::refuse)?;
        misread::refuse_lengths(&file)?;
        let read = || {
            let model = reader().model_for_proto_model(&file)?.into_typed()?;
            unrolled::unrolled(model)?.into_decluttered()
        };
        let model = guarded(read).map_err(|reason| CompileError::Unreadable { reason })?;
        let mut facts = selection.facts(&file, &model, options)?;
        let scores = selection.scores(&outputs, &model);
        let source = cut(&source, &outputs);
        normaliser::note_normals(&source, &mut facts);
        let interface = Interface { facts, outputs, scores };
        Ok(Self { source, file, model, interface, batches })
    }
}

/// The inputs and outputs of a file with their types and sizes, as far as they are known.
pub(crate) type Described = [Vec<(String, String)>; 2];

/// Describes the inputs and outputs of a file whose sizes can be fixed.
pub(crate) fn described(onnx: &[u8], options: &PolicyOptions) -> Result<Described, CompileError> {
    let (_, Values { inputs, outputs }) = taken_apart(&fixed(onnx, options)?.0);
    let describe = |value: Value| (value.name.clone(), value.text());
    Ok([inputs, outputs].map(|values| values.into_iter().map(describe).collect()))
}

/// Describes the inputs and outputs of a file as it stands, sizes left open by their names.
pub(crate) fn declared(file: &pb::ModelProto) -> Described {
    let graph = file.graph.as_ref();
    let describe = |value: &pb::ValueInfoProto| (value.name.clone(), values::declared_text(value));
    let inputs = graph.map(|graph| graph.input.iter().map(describe).collect());
    let outputs = graph.map(|graph| graph.output.iter().map(describe).collect());
    [inputs, outputs].map(Option::unwrap_or_default)
}

/// A file with all sizes fixed, and the likeliest of what it draws; and the sizes that were taken for the batch.
fn fixed(
    onnx: &[u8],
    options: &PolicyOptions,
) -> Result<(pb::ModelProto, Vec<(String, String)>), CompileError> {
    let mut file = guarded(|| reader().proto_model_for_read(&mut &*onnx))
        .map_err(|reason| CompileError::Unreadable { reason })?;
    prepared::place_functions(&mut file);
    prepared::widen(&mut file);
    let graph = file.graph.get_or_insert_default();
    let batches = prepared::fix(graph, &options.sizes)?;
    if options.outputs.iter().any(|output| output.ends_with(nodes::LIKELIEST)) {
        nodes::take_likeliest(graph);
    }
    Ok((file, batches))
}

/// A file as tract reads it, and what goes into and comes out of it.
fn taken_apart(source: &pb::ModelProto) -> (pb::ModelProto, Values) {
    let mut file = source.clone();
    prepared::narrow(&mut file);
    apart::take_apart(&mut file);
    let values = Values::of(&file);
    (file, values)
}
