//! Policies of somebody else with int8 weights, judged by how they act.

use std::path::Path;

use serde::Serialize;
use sortie_plans::{
    CompileError, CompileOptions, LARGEST_DEVIATION, LEAST_AGREEMENT, LEAST_OBSERVATIONS,
    PolicyAgreement, QuantisedPolicy, RecordedCase, Report, quantise_policy,
};

use super::{CompileArguments, print_operators, refuse};
use sortie_cli::compiler::compiler;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::npz;
use sortie_cli::output::{Table, print_json, say};
use sortie_cli::recorded_inputs::RecordedInputs;

#[derive(Serialize)]
struct Written<'a> {
    plan: &'a Path,
    #[serde(flatten)]
    report: &'a Report,
    agreement: &'a PolicyAgreement,
    exact: &'a Report,
}

/// Compiles a policy to int8 weights; refuses what acts differently than the f32 plan.
pub(super) fn quantised(
    arguments: &CompileArguments,
    onnx: &[u8],
    options: &CompileOptions,
    file: &Path,
    failed: &dyn Fn(CompileError) -> Failure,
) -> Result<QuantisedPolicy, Failure> {
    let arrays = npz::read(file)?;
    let policy = arguments.policy.options_for(&arguments.onnx)?;
    let facts = compiler().rehearse_policy(onnx, &policy).map_err(failed)?;
    let recorded = RecordedInputs::of(&facts, &arrays)
        .map_err(|reason| Failure::new(Exit::BadData, format!("{}: {reason}", file.display())))?;
    let cases: Vec<RecordedCase<'_>> =
        (0..recorded.count).map(|case| recorded.case(case)).collect();
    let compile =
        |profile| compiler().compile_policy(onnx, &policy, &CompileOptions { profile, ..*options });
    let quantised = quantise_policy(compile, &cases).map_err(failed)?;
    judge(&quantised.agreement, arguments.force)?;
    Ok(quantised)
}

/// Refuses a plan that acts differently, or of which too little is known.
fn judge(agreement: &PolicyAgreement, force: bool) -> Outcome {
    let observations = agreement.observations;
    if observations < LEAST_OBSERVATIONS {
        return refuse(
            &format!(
                "{observations} observations say too little about an int8 plan, {LEAST_OBSERVATIONS} are needed: \
                 record more"
            ),
            force,
        );
    }
    if agreement.is_enough() {
        return Ok(());
    }
    let flaw = format!(
        "the int8 plan takes the same action on {:.3} % of the observations, {:.1} % are needed; its continuous \
         actions differ by {:.3} of what they vary by, {LARGEST_DEVIATION} is allowed",
        100.0 * agreement.share(),
        100.0 * LEAST_AGREEMENT,
        agreement.largest_deviation()
    );
    refuse(&flaw, force)
}

pub(super) fn print(arguments: &CompileArguments, quantised: &QuantisedPolicy) {
    let QuantisedPolicy { compiled, exact, agreement } = quantised;
    let (plan, report) = (arguments.output.as_path(), &compiled.compiled.report);
    if arguments.common.json {
        print_json(&Written { plan, report, agreement, exact });
        return;
    }
    let mut table = Table::new(&["output", "same action", "largest error / deviation"]);
    for output in &agreement.outputs {
        let same = output.equal_actions.map(|equal| {
            format!("{:.3} %", 100.0 * equal as f64 / agreement.observations.max(1) as f64)
        });
        let deviation = format!("{:.4}", output.largest_deviation);
        table.row([output.name.clone(), same.unwrap_or_default(), deviation]);
    }
    say!("on {} recorded observations, beside the f32 plan", agreement.observations);
    table.print();
    say!();
    let mut table = Table::new(&["bytes", "int8", "f32"]);
    let mut row = |name: &str, int8: usize, exact: usize| {
        table.row([name.to_string(), int8.to_string(), exact.to_string()]);
    };
    row("flash", report.flash_bytes, exact.flash_bytes);
    row("arena", report.arena_bytes, exact.arena_bytes);
    table.print();
    say!();
    print_operators(report);
}
