//! Guards that `--guards` and `--guard-inputs` ask for: written behind a policy's plan, or into a bundle.

use std::path::Path;

use sortie_bundle::files::{MOST_TEXT_BYTES, read_file};
use sortie_bundle::{ContractV1, Recording, guards_from_toml};
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::guards::read_guards;
use sortie_cli::npz::{self, RecordedInputs};
use sortie_core::plan::{AlignedBytes, GuardFacts, GuardedSizes, InputGuards, Network, Plan};
use sortie_ipc::PolicySchema;
use sortie_plans::{Annex, CompileError};

use super::CompileArguments;

/// What the file says; none where no guards are asked for.
///
/// # Errors
/// The file cannot be read, or ranges of inputs are asked for twice, or of nothing.
pub(super) fn asked(arguments: &CompileArguments) -> Result<Option<GuardFacts>, Failure> {
    let facts = arguments.guards.as_deref().map(read_guards).transpose()?;
    if arguments.guard_inputs.is_none() {
        return Ok(facts);
    }
    if arguments.npz.is_none() {
        let message =
            "`--guard-inputs` takes ranges from what was recorded: name it with `--npz FILE`";
        return Err(Failure::new(Exit::Usage, message));
    }
    let facts = facts.unwrap_or_default();
    if !facts.inputs.is_empty() {
        let message = "`--guard-inputs` takes the ranges of inputs from what was recorded: leave `inputs` of the file \
                       out, or the flag";
        return Err(Failure::new(Exit::Usage, message));
    }
    Ok(Some(facts))
}

/// Writes the guards behind `written`, which is `plan` as it will stand in the file.
///
/// # Errors
/// The plan is no policy's, what was recorded does not fit, or the guards have a flaw.
pub(super) fn append(
    arguments: &CompileArguments,
    plan: &[u8],
    written: &mut Vec<u8>,
) -> Result<(), Failure> {
    let Some(mut facts) = asked(arguments)? else { return Ok(()) };
    let bytes = AlignedBytes::copy_of(plan);
    let loaded = Plan::load(bytes.as_slice()).map_err(CompileError::from)?;
    if loaded.check_network(Network::Policy).is_err() {
        let message =
            "guards are for policies over inputs of fixed sizes: agents of a team observe entities";
        return Err(Failure::new(Exit::Usage, message));
    }
    let sizes = GuardedSizes {
        inputs: loaded.inputs().sum(),
        outputs: loaded.outputs().sum(),
        chooses: PolicySchema::of_plan(&loaded)?.actions != 0,
    };
    if let (Some(margin), Some(file)) = (arguments.guard_inputs, &arguments.npz) {
        facts.inputs = recorded(file, plan, sizes.inputs, margin)?;
    }
    facts.append_to(written, &sizes).map_err(|flaw| match &arguments.guards {
        Some(file) => Failure::new(Exit::BadData, flaw).within(file.display()),
        None => Failure::new(Exit::BadData, flaw),
    })
}

/// Lowest and highest of what was recorded of each input, and a margin.
fn recorded(file: &Path, plan: &[u8], inputs: usize, margin: f32) -> Result<InputGuards, Failure> {
    let bad = |reason: String| Failure::new(Exit::BadData, reason).within(file.display());
    let annex = Annex::of_plan(plan)?.ok_or_else(|| bad("the plan names no inputs".to_owned()))?;
    let arrays = npz::read(file)?;
    let cases = RecordedInputs::of(&annex.facts, &arrays).map_err(bad)?;
    let mut seen = InputGuards::unseen(inputs);
    for case in 0..cases.count {
        seen.see(cases.case(case).inputs.into_iter().flatten());
    }
    widened(seen, margin)
        .map_err(|at| bad(format!("input {at} has no finite range, which guards need")))
}

/// What was seen and a margin; or the first number that has no finite range.
fn widened(mut seen: InputGuards, margin: f32) -> Result<InputGuards, usize> {
    seen.widen(margin);
    let mut limits = seen.lowest.iter().zip(&seen.highest);
    let is_limit = |(lowest, highest): (&f32, &f32)| lowest.is_finite() && highest.is_finite();
    match limits.position(|range| !is_limit(range)) {
        Some(at) => Err(at),
        None => Ok(seen),
    }
}

/// The ranges for the agents of a team that the file names; none where no file is named.
///
/// # Errors
/// The file cannot be read, or says something that agents of a team are not guarded by.
pub(super) fn of_team(
    file: Option<&Path>,
    contract: &ContractV1,
) -> Result<Option<Vec<[f32; 2]>>, Failure> {
    let Some(file) = file else { return Ok(None) };
    let text = read_file(file, MOST_TEXT_BYTES).map_err(|error| Failure::file(file, &error))?;
    let ranges = guards_from_toml(&text, contract);
    ranges.map(Some).map_err(|flaw| Failure::new(Exit::BadData, flaw).within(file.display()))
}

/// The ranges of everything that agents were seen to act on: rows of what they saw and their own.
pub(super) fn seen_by_team(recording: &Recording, margin: f32) -> Result<Vec<[f32; 2]>, Failure> {
    let mut seen = InputGuards::unseen(recording.features);
    for observation in recording.observations() {
        let own = std::iter::once(observation.self_index);
        for entity in observation.visible.iter().chain(own) {
            let row = observation.rows.get(entity * observation.stride..);
            seen.see(row.unwrap_or_default().iter().take(recording.features));
        }
    }
    let seen = widened(seen, margin).map_err(|at| {
        let message =
            format!("feature {at} has no finite range in what was recorded, which guards need");
        Failure::new(Exit::BadData, message)
    })?;
    let InputGuards { lowest, highest } = seen;
    Ok(lowest.into_iter().zip(highest).map(|(lowest, highest)| [lowest, highest]).collect())
}

/// A share of a range's width.
pub(super) fn margin(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(margin) if (0.0..=1.0e6).contains(&margin) => Ok(margin),
        _ => Err("expected a share of the width, 0 or more".to_owned()),
    }
}
