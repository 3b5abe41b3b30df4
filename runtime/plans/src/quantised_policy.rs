//! Policies with int8 weights, and how they act.

use sortie_core::plan::Profile;

use crate::agreement::note_mismatch;
use crate::annex::Annex;
use crate::error::CompileError;
use crate::policy_agreement::{PolicyAgreement, RecordedCase, policy_agreement};
use crate::policy_plan::CompiledPolicy;
use crate::report::Report;

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
