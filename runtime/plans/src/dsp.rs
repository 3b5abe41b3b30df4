//! Plans of int8 weights: as processors with the DSP extension read them, and of policies with how they act.

use std::collections::BTreeSet;

use sortie_core::internal::ops::{Int8Layer, LAYOUT_INT8_DSP, OpRef};
use sortie_core::plan::{AlignedBytes, Plan, Profile};

use crate::agreement::{note_mismatch, seal};
use crate::error::CompileError;
use crate::facts::Annex;
use crate::policy_plan::{CompiledPolicy, PolicyAgreement, RecordedCase, policy_agreement};
use crate::report::Report;

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
    // Operators may share a matrix.
    let matrices: BTreeSet<(u32, usize)> = loaded.program().ops().flat_map(matrices).collect();
    for (start, len) in matrices {
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
        OpRef::Int8ConvolvePatches(op) => vec![(op.weights, op.weights_len() as usize)],
        OpRef::Int8AttendOwn(op) => vec![
            of_layer(&op.query),
            (op.keys, op.keys_len()),
            (op.values, op.values_len()),
            of_layer(&op.output),
        ],
        _ => Vec::new(),
    }
}

/// A policy of few bits beside the exact one.
#[derive(Clone, Debug)]
pub struct QuantisedPolicy {
    /// Its plan, whose header and annex say how it acts.
    pub compiled: CompiledPolicy,
    /// What the exact plan costs.
    pub exact: Report,
    /// How both act.
    pub agreement: PolicyAgreement,
}

/// Compiles a policy to int8 weights, and asks that plan and the exact one about what was recorded. `compile` compiles
/// the policy in a profile.
///
/// Whether the agreement is enough is the caller's to judge ([`PolicyAgreement::is_enough`]).
///
/// # Errors
/// The policy has no such plan, or what was recorded cannot be decided on.
pub fn quantise_policy(
    compile: impl Fn(Profile) -> Result<CompiledPolicy, CompileError>,
    cases: &[RecordedCase<'_>],
) -> Result<QuantisedPolicy, CompileError> {
    let exact = compile(Profile::Exact)?;
    let mut compiled = compile(Profile::Int8)?;
    let agreement = policy_agreement(&compiled, &exact, cases)?;
    let plan = &mut compiled.compiled.bytes;
    note_mismatch(plan, 1.0 - agreement.share())?;
    let annex = Annex::of_plan(plan)?;
    let annex = annex.unwrap_or_else(|| Annex::new(compiled.facts.clone(), []));
    Annex { agreement: Some(agreement.clone()), ..annex }.replace_in(plan)?;
    Ok(QuantisedPolicy { compiled, exact: exact.compiled.report, agreement })
}

#[cfg(test)]
mod tests {
    use sortie_core::plan::{Header, PlanError};

    use super::*;

    fn golden(name: &str) -> Vec<u8> {
        let path = std::path::Path::new("../../tests/golden/plans").join(name);
        std::fs::read(path).unwrap()
    }

    #[test]
    fn weights_of_neighbouring_outputs_change_places_and_nothing_else_does() {
        for name in ["agent-int8-2.2.plan", "agent-skip-int8-2.2.plan"] {
            let plan = golden(name);
            let dsp = for_dsp(&plan).unwrap();
            let (header, _) = Header::read(&plan).unwrap();
            let start = header.weights_offset as usize;
            let original = AlignedBytes::copy_of(&plan);
            let loaded = Plan::load(original.as_slice()).unwrap();
            let mut of_matrices = vec![false; plan.len()];
            for (first, len) in loaded.program().ops().flat_map(matrices) {
                of_matrices[start + 4 * first as usize..][..4 * len].fill(true);
            }
            assert!(of_matrices.iter().filter(|is| **is).count() > 500);
            for (index, is_weight) in of_matrices.iter().enumerate().skip(start) {
                // Byte 4c + 1 is the first input's weight for output 2c + 1, 4c + 2 the second's for output 2c.
                let from = match index % 4 {
                    1 if *is_weight => index + 1,
                    2 if *is_weight => index - 1,
                    _ => index,
                };
                assert_eq!(dsp.as_slice()[index], plan[from], "byte {index} of {name}");
            }
            let (laid_out, _) = Header::read(dsp.as_slice()).unwrap();
            assert_eq!(laid_out, Header { layout: LAYOUT_INT8_DSP, ..header });
            let refused = Plan::load(dsp.as_slice()).map(drop);
            assert_eq!(refused, Err(PlanError::WrongLayout { got: LAYOUT_INT8_DSP }));
        }
    }

    #[test]
    fn plans_of_f32_are_the_same_for_all_processors() {
        let plan = golden("agent-2.0.plan");
        assert_eq!(for_dsp(&plan).unwrap().as_slice(), plan);
        assert!(for_dsp(&plan[..200]).is_err());
    }
}
