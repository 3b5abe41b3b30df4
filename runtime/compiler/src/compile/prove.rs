//! Whether the plan of a network gives what the network's file says, in double precision.

use sortie_core::plan::Profile;
use sortie_plans::{
    Comparison, CompileError, CompileOptions, Distances, Family, NetworkFiles, NetworkInput, Rows,
    True, TrueAnswers, compare_with_truth, inspect_plan, output_widths, plan_answers,
};

use crate::networks::{Graphs, TrueNetwork};

/// Multiply-adds of all inputs of a proof together, which the reference evaluator does nine times over in a second.
const MOST_MULTIPLY_ADDS: u64 = 50_000_000;

/// Inputs that prove a network however large it is.
const LEAST: usize = 32;

/// Of `inputs` as many as can be afforded for a network of so many multiply-adds.
pub(crate) fn affordable(inputs: usize, multiply_adds: u64) -> usize {
    let affordable = MOST_MULTIPLY_ADDS / multiply_adds.max(1);
    inputs.min(usize::try_from(affordable).unwrap_or(inputs).max(LEAST))
}

/// Compares a plan with its network's files, in double precision.
///
/// # Errors
/// Plan or files cannot be read, or do not belong together.
pub fn compare_with_files(
    plan: &[u8],
    files: &NetworkFiles<'_>,
    inputs: Vec<NetworkInput>,
    seed: u64,
) -> Result<Comparison, CompileError> {
    beside_truth(plan, &Graphs::read(files)?, inputs, seed).map(|(comparison, _)| comparison)
}

/// Refuses a plan that is further from the truth than rounding accounts for; of an int8 plan the distance is only
/// measured, as its actions in the real environment decide about it.
pub(super) fn prove(
    plan: &[u8],
    graphs: &Graphs,
    mut inputs: Vec<NetworkInput>,
    options: &CompileOptions,
) -> Result<Comparison, CompileError> {
    let facts = inspect_plan(plan)?;
    inputs.truncate(affordable(inputs.len(), facts.macs));
    let (comparison, distances) = beside_truth(plan, graphs, inputs, options.seed)?;
    if comparison.refusals_differ > 0 {
        let reason = "on an input of the proof only one of plan and network gives an answer";
        return Err(CompileError::Run { reason: reason.to_owned() });
    }
    if options.profile != Profile::Int8 && !(distances.is_right() && comparison.agrees()) {
        return Err(distances.error(options.seed));
    }
    Ok(comparison)
}

fn beside_truth(
    plan: &[u8],
    graphs: &Graphs,
    mut inputs: Vec<NetworkInput>,
    seed: u64,
) -> Result<(Comparison, Distances), CompileError> {
    let features = inspect_plan(plan)?.features;
    let answers = plan_answers(plan, &mut inputs, seed)?;
    let mut network = TrueNetwork::new(graphs, features, seed)?;
    let truth = |input: &NetworkInput| network.answer(input, Rows::All).map(Some);
    let truths: Vec<Option<True>> = inputs.iter().map(truth).collect::<Result<_, _>>()?;
    let widths = output_widths(plan)?;
    let mut distances = Distances::default();
    for (input, (answer, truth)) in answers.iter().zip(&truths).enumerate() {
        let outputs = answer.iter().flat_map(|answer| &answer.outputs);
        let outputs = outputs.zip(truth.iter().flatten()).zip(&widths);
        let mut first = 0;
        for ((numbers, truths), width) in outputs {
            distances.add(input, numbers, truths, |at| first + at % width.max(&1));
            first += width;
        }
    }
    let family = Family::of("plan against double precision", inputs);
    Ok((compare_with_truth(&family, &answers, &truths), distances))
}

#[cfg(test)]
mod tests;
