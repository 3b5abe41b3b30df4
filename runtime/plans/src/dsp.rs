//! Plans of int8 weights as processors with the DSP extension read them.

use sortie_core::internal::ops::{Int8Layer, LAYOUT_INT8_DSP, OpRef};
use sortie_core::plan::{AlignedBytes, Plan, Profile};

use crate::agreement::seal;
use crate::error::CompileError;

/// The same plan with int8 weights laid out for the DSP extension of ARM (Cortex-M4, M7 and later): builds of `sortie-core` with
/// the feature `dsp` read those alone, and give the same bits. Plans of other profiles are the same for all.
///
/// # Errors
/// It is no plan that this build reads.
pub fn for_dsp(plan: &[u8]) -> Result<AlignedBytes, CompileError> {
    let mut copy = AlignedBytes::copy_of(plan);
    let original = AlignedBytes::copy_of(plan);
    let loaded = Plan::load(original.as_slice())?;
    let mut header = *loaded.header();
    if header.profile != Profile::Int8 {
        return Ok(copy);
    }
    header.layout = LAYOUT_INT8_DSP;
    let weights = copy.as_mut_slice().get_mut(header.weights_offset as usize..);
    let (words, _) = weights.unwrap_or_default().as_chunks_mut::<4>();
    for (start, len) in loaded.program().ops().flat_map(matrices) {
        for word in words.iter_mut().skip(start as usize).take(len) {
            word.swap(1, 2);
        }
    }
    seal(copy.as_mut_slice(), &header);
    Ok(copy)
}

/// Where the int8 matrices of an operator start and how long they are, in words.
fn matrices(op: OpRef<'_>) -> Vec<(u32, usize)> {
    let of_layer = |layer: &Int8Layer| (layer.weights, layer.weights_len());
    match op {
        OpRef::Int8EmbedEntities(op) => vec![of_layer(&op.layer)],
        OpRef::Int8Dense(op) => vec![of_layer(&op.layer)],
        OpRef::Int8AttendOwn(op) => vec![
            of_layer(&op.query),
            (op.keys, op.keys_len()),
            (op.values, op.values_len()),
            of_layer(&op.output),
        ],
        _ => Vec::new(),
    }
}
