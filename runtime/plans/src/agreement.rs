//! Whether an int8 plan acts as the network that it was made from: on observations of the real environment.

use serde::Serialize;
use sortie_bundle::Recording;
use sortie_core::plan::{AlignedBytes, HEADER_BYTES, Header, Plan, Profile, checksums};
use sortie_core::{PlanPolicy, Policy};

use crate::comparison::{Comparison, cannot_run, relative_error};
use crate::error::CompileError;
use crate::report::{Compiled, Report};

/// Least share of observations on which an int8 plan takes the same action.
pub const LEAST_AGREEMENT: f64 = 0.995;

/// Of so many frames of a recording one is for rounding weights, the others judge.
const ONE_IN: usize = 10;

/// Least number of observations that say anything about a plan.
pub const LEAST_OBSERVATIONS: usize = 10_000;

/// The name of comparisons on recorded observations.
pub const RECORDED: &str = "recorded";

/// How often two plans take the same action, greedily.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// Observations that both plans decided on.
    pub observations: usize,
    /// Those on which both took the same action.
    pub equal_actions: usize,
    /// Largest difference of any utility.
    pub max_utility_error: f32,
    /// Largest |a - b| / (1 + m) of any utility, with m the largest |b| of its observation.
    pub max_rel_error: f32,
}

impl Agreement {
    /// Share of observations with the same action.
    pub fn share(&self) -> f64 {
        self.equal_actions as f64 / self.observations.max(1) as f64
    }

    /// Whether the share is at least [`LEAST_AGREEMENT`].
    pub fn is_enough(&self) -> bool {
        self.share() >= LEAST_AGREEMENT
    }
}

/// An int8 plan beside the f32 plan of the same network.
#[derive(Clone, Debug)]
pub struct Quantised {
    /// The int8 plan, whose header says the share of other actions.
    pub compiled: Compiled,
    /// What the f32 plan costs.
    pub exact: Report,
    /// How both act on the observations that no weight was rounded for.
    pub agreement: Agreement,
}

/// Compiles a network to an int8 plan, rounded for a tenth of what was recorded, and asks it and the f32 plan about the
/// other observations. `compile` compiles the network in a profile, and rounds what it rounds for the
/// observations that it is given.
///
/// Whether the agreement is enough is the caller's to judge ([`Agreement::is_enough`]), as is the number of
/// observations ([`LEAST_OBSERVATIONS`]).
pub fn quantise(
    compile: impl Fn(Profile, &Recording) -> Result<Compiled, CompileError>,
    recording: &Recording,
) -> Result<Quantised, CompileError> {
    let [examples, judges] = recording.split(ONE_IN);
    let exact = compile(Profile::Exact, &examples)?;
    let mut compiled = compile(Profile::Int8, &examples)?;
    let agreement = agreement_of_plans(&compiled.bytes, &exact.bytes, &judges)?;
    note_mismatch(&mut compiled.bytes, 1.0 - agreement.share())?;
    Ok(Quantised { compiled, exact: exact.report, agreement })
}

/// Asks two plans about the same observations.
fn agreement_of_plans(
    plan: &[u8],
    reference: &[u8],
    recording: &Recording,
) -> Result<Agreement, CompileError> {
    let [plan, reference] = [plan, reference].map(AlignedBytes::copy_of);
    let plan = Plan::load(plan.as_slice())?;
    let reference = Plan::load(reference.as_slice())?;
    let (features, actions) = (plan.header().features as usize, plan.actions());
    for (what, got, want) in [
        ("the number of features of the recording", recording.features, features),
        ("the number of actions of the recording", recording.actions, actions),
    ] {
        if got != want {
            return Err(CompileError::Size { what: what.into(), got, want });
        }
    }
    let mut arenas = [&plan, &reference].map(|plan| AlignedBytes::zeroed(plan.arena_bytes()));
    let [arena, reference_arena] = &mut arenas;
    let mut plan = PlanPolicy::boxed(plan, arena.as_mut_slice())?;
    let mut reference = PlanPolicy::boxed(reference, reference_arena.as_mut_slice())?;
    agreement(plan.as_mut(), reference.as_mut(), recording)
}

/// Asks two policies about the same observations.
///
/// # Errors
/// One of them cannot decide on an observation.
pub fn agreement(
    plan: &mut dyn Policy,
    reference: &mut dyn Policy,
    recording: &Recording,
) -> Result<Agreement, CompileError> {
    let (plan_memory, actions) = (plan.hidden(), reference.actions());
    let mut agreement =
        Agreement { observations: 0, equal_actions: 0, max_utility_error: 0.0, max_rel_error: 0.0 };
    let (mut got, mut want) = (vec![0.0; actions], vec![0.0; actions]);
    for observation in recording.observations() {
        // A recording holds no memories.
        let empty = || vec![0.0; plan_memory];
        plan.utilities_with(&observation, &mut empty(), &mut got).map_err(cannot_run)?;
        reference.utilities_with(&observation, &mut empty(), &mut want).map_err(cannot_run)?;
        let errors = got.iter().zip(&want).map(|(got, want)| (got - want).abs());
        let error = errors.fold(0.0, f32::max);
        agreement.max_utility_error = agreement.max_utility_error.max(error);
        agreement.max_rel_error = agreement.max_rel_error.max(relative_error(&got, &want));
        let action = plan.decide_with(&observation, &mut empty()).map_err(cannot_run)?.action;
        let wanted = reference.decide_with(&observation, &mut empty()).map_err(cannot_run)?.action;
        agreement.observations += 1;
        agreement.equal_actions += usize::from(action == wanted);
    }
    Ok(agreement)
}

impl From<Agreement> for Comparison {
    fn from(agreement: Agreement) -> Self {
        Self {
            inputs: agreement.observations,
            max_rel_error: agreement.max_rel_error,
            max_judged_error: agreement.max_rel_error,
            action_mismatches: agreement.observations - agreement.equal_actions,
            ..Self::new(RECORDED)
        }
    }
}

/// Writes the share of other actions into a plan's header.
pub(crate) fn note_mismatch(plan: &mut [u8], share: f64) -> Result<(), CompileError> {
    let (mut header, _) = Header::read(plan)?;
    header.action_mismatch = share as f32;
    seal(plan, &header);
    Ok(())
}

/// Gives a plan this header, with the checksums of what the plan holds.
pub(crate) fn seal(plan: &mut [u8], header: &Header) {
    let part =
        |offset: u32, len: u32| plan.get(offset as usize..).and_then(|p| p.get(..len as usize));
    let program = part(header.program_offset, header.program_len).unwrap_or_default();
    let weights = part(header.weights_offset, header.weights_len).unwrap_or_default();
    let bytes = header.to_bytes(checksums(header, program, weights));
    if let Some(to) = plan.first_chunk_mut::<HEADER_BYTES>() {
        *to = bytes;
    }
}
