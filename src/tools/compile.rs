//! `sortie compile`: an ONNX network becomes a plan, proved against its source.

mod bundle;
mod guards;

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::{Kind, read_any_recording, try_output, write_output};
use sortie_cli::foreign::PolicyArguments;
use sortie_cli::output::{Common, Table, print_json, say, tell};
use sortie_cli::policy::PlanProfile;
use sortie_cli::tools::{check_program, compiler};
use sortie_core::plan::Profile;
use sortie_plans::{
    Agreement, CompileError, CompileOptions, Compiled, Compiler, LEAST_AGREEMENT,
    LEAST_OBSERVATIONS, PolicyOptions, Quantised, Report, for_dsp, quantise, read_onnx,
};

use self::bundle::Paired;

/// Compile an ONNX network to a plan for the runtime core
///
/// The plan is compared with the network in double precision, on random observations of all mask patterns, and refused where
/// it is further off than the rounding of 32 bits accounts for. The weights of an int8 plan are rounded for a tenth of the recorded observations,
/// and the plan is compared with the f32 plan on all others instead: it is refused where it takes another action in more
/// than 0.5 % of them. Prints what the plan will cost: flash, arena, work.
///
/// A policy that somebody else exported becomes a plan of general steps; what is what in it is found, or said by flags.
///
/// Given a bundle, writes the same bundle with plans of its own networks, which run without being compiled again. With
/// `--profile int8` it writes the plan of the bundle's agents instead, rounded for episodes that it plays, and judges it
/// by success over 2,000 episodes that the f32 plan plays too: more than 0.01 below is refused.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie compile models/save-the-city/agent.onnx -o agent.plan --n-max 11
  sortie compile models/save-the-city/agent.onnx -o agent.plan --n-max 11 --profile int8 --observations seen.bin
  sortie compile walking.onnx -o walking.plan
  sortie compile walking.onnx -o walking.plan --npz recorded.npz
  sortie compile walking.onnx -o walking.plan --profile int8 --npz recorded.npz
  sortie compile walking.onnx -o walking.plan --guards guards.toml --npz recorded.npz --guard-inputs 0.1
  sortie compile models/first -o models/first-with-plans
  sortie compile models/first -o models/first-guarded --guard-inputs 0.1
  sortie compile models/save-the-city -o agent.plan --profile int8
  sortie compile models/save-the-city -o agent.plan --profile int8 --dsp")]
pub(crate) struct CompileArguments {
    /// The network, or the folder of a bundle
    #[arg(value_name = "ONNX|BUNDLE")]
    onnx: PathBuf,
    /// Where to write the plan, or the new bundle
    #[arg(short, long = "out", value_name = "PLAN|BUNDLE")]
    output: PathBuf,
    /// Most visible entities, which sizes the arena
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=128))]
    n_max: u16,
    /// How the plan computes
    #[arg(long, value_enum, default_value_t = PlanProfile::Exact)]
    profile: PlanProfile,
    /// Observations of `sortie eval BUNDLE --dump FILE`, for some of which an int8 plan is rounded, and on the others of
    /// which it must act as the f32 plan does
    #[arg(long, value_name = "FILE")]
    observations: Option<PathBuf>,
    /// Recorded inputs `in__NAME` of a policy of somebody else, on which its plan is proved as well, and on which its int8
    /// plan must act as the f32 plan does: arrays that `numpy.savez` saved, one case behind the other
    #[arg(long, value_name = "FILE", conflicts_with = "observations")]
    npz: Option<PathBuf>,
    /// What a policy's plan is let see and let do, as TOML: ranges, rates, age, and what is done beyond them. Of a bundle, the
    /// ranges of what its agents may act on
    #[arg(long, value_name = "FILE")]
    guards: Option<PathBuf>,
    /// Guard inputs by the lowest and highest of `--npz`, widened by this share of their distance on either side; of a bundle
    /// by those of `--observations`, or of 100 episodes that its agents play
    #[arg(long, value_name = "MARGIN", value_parser = guards::margin)]
    guard_inputs: Option<f32>,
    /// Write an int8 plan however seldom it takes the same action or succeeds, and whatever was recorded
    #[arg(long)]
    force: bool,
    /// Lay the weights of an int8 plan out for Cortex-M4, M7 and others with the DSP extension: builds of `sortie-core` with the
    /// feature `dsp` read such plans alone, other builds refuse them
    #[arg(long)]
    dsp: bool,
    #[command(flatten)]
    policy: PolicyArguments,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Written<'a, A> {
    plan: &'a Path,
    #[serde(flatten)]
    report: &'a Report,
    /// How an int8 plan acts beside the f32 plan of the same network, and what that costs.
    #[serde(skip_serializing_if = "Option::is_none")]
    agreement: Option<&'a A>,
    /// What an int8 plan of a bundle achieves beside the f32 plan.
    #[serde(skip_serializing_if = "Option::is_none")]
    paired: Option<&'a Paired>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exact: Option<&'a Report>,
}

#[derive(Serialize)]
struct WrittenBundle<'a> {
    bundle: &'a Path,
    sha256: String,
}

#[derive(Serialize)]
struct Refused<'a> {
    error: Refusal<'a>,
}

#[derive(Serialize)]
struct Refusal<'a> {
    message: String,
    node: Option<&'a str>,
    operator: Option<&'a str>,
    shapes: Option<&'a str>,
    hint: Option<&'a str>,
}

pub(crate) fn run(arguments: &CompileArguments) -> Outcome {
    let path = &arguments.onnx;
    check_program()?;
    if arguments.dsp && arguments.profile != PlanProfile::Int8 {
        let message = "`--dsp` lays weights of int8 out, and goes with `--profile int8`: plans of other profiles are the \
                       same for all processors";
        return Err(Failure::new(Exit::Usage, message));
    }
    if path.is_dir() {
        return bundle::compile_bundle(arguments);
    }
    // What is wrong with the guards is said before anything takes its time.
    guards::asked(arguments)?;
    let onnx = read_onnx(path).map_err(|error| Failure::file(path, &error))?;
    let options = CompileOptions {
        n_max: arguments.n_max.into(),
        profile: arguments.profile.profile(),
        seed: arguments.common.seed,
        ..CompileOptions::default()
    };
    let failed = |error: CompileError| {
        if arguments.common.json {
            print_json(&Refused { error: refusal(&error) });
        }
        Failure::from(error).within(path.display())
    };
    let plan = &arguments.output;
    try_output(plan, Kind::Plan)?;
    let recording = arguments.observations.as_deref().map(read_any_recording).transpose()?;
    if let (Profile::Int8, Some(recording)) = (options.profile, &recording) {
        let compile = |profile, examples: &_| {
            compiler().compile_rounded(&onnx, &CompileOptions { profile, ..options }, examples)
        };
        let quantised = quantise(compile, recording).map_err(failed)?;
        if !arguments.common.json && !arguments.common.quiet {
            print_agreement(&quantised);
        }
        judge(&quantised.agreement, arguments.force)?;
        write_plan(arguments, &quantised.compiled.bytes)?;
        let Quantised { compiled, exact, agreement } = &quantised;
        print(arguments, &compiled.report, Some((agreement, exact)), None);
        return Ok(());
    }
    if let (Profile::Int8, Some(file)) = (options.profile, &arguments.npz) {
        let quantised = bundle::quantised(arguments, &onnx, &options, file, &failed)?;
        write_plan(arguments, &quantised.compiled.compiled.bytes)?;
        bundle::print_policy(arguments, &quantised);
        return Ok(());
    }
    if options.profile == Profile::Int8 {
        let message = "an int8 plan is judged by how it acts on recorded observations: name them with \
                       `--observations FILE` (agents of this trainer) or `--npz FILE` (other policies)";
        return Err(Failure::new(Exit::Usage, message));
    }
    let policy = arguments.policy.options_for(path)?;
    let (compiled, remarks) = match &arguments.npz {
        Some(file) => bundle::recorded(arguments, &onnx, &options, file, &failed)?,
        None => compile_any(&onnx, &options, &policy).map_err(failed)?,
    };
    remarks.iter().for_each(|remark| tell!("note: {remark}"));
    write_plan(arguments, &compiled.bytes)?;
    print(arguments, &compiled.report, None, None);
    Ok(())
}

/// Writes a plan, laid out and guarded as is asked for.
fn write_plan(arguments: &CompileArguments, plan: &[u8]) -> Outcome {
    let mut written =
        if arguments.dsp { for_dsp(plan)?.as_slice().to_vec() } else { plan.to_vec() };
    guards::append(arguments, plan, &mut written)?;
    write_output(&arguments.output, &written)
}

/// Compiles a network of ours, or a policy of somebody else: what says something about one means one. With the plan comes
/// what should be known of it.
fn compile_any(
    onnx: &[u8],
    options: &CompileOptions,
    policy: &PolicyOptions,
) -> Result<(Compiled, Vec<String>), CompileError> {
    let of_others = || {
        let of = compiler().compile_policy(onnx, policy, options)?;
        Ok((of.compiled, of.remarks))
    };
    if *policy != PolicyOptions::default() {
        return of_others();
    }
    match compiler().compile(onnx, options) {
        // Sizes that are left open can end the reading of a network before its inputs are looked at.
        Err(CompileError::Inputs { .. } | CompileError::Unreadable { .. }) => of_others(),
        compiled => Ok((compiled?, Vec::new())),
    }
}

/// Refuses an int8 plan that acts differently too often, or of which too little is known.
fn judge(agreement: &Agreement, force: bool) -> Outcome {
    let Agreement { observations, .. } = *agreement;
    let flaw = if observations < LEAST_OBSERVATIONS {
        format!(
            "{observations} observations say too little about an int8 plan, {LEAST_OBSERVATIONS} are needed that its \
             weights were not rounded for: record more with `sortie eval BUNDLE --episodes 1000 --dump FILE`"
        )
    } else if !agreement.is_enough() {
        format!(
            "the int8 plan takes the same action on {:.3} % of the observations, {:.1} % are needed",
            100.0 * agreement.share(),
            100.0 * LEAST_AGREEMENT
        )
    } else {
        return Ok(());
    };
    refuse(&flaw, force)
}

/// Ends the command for a flaw, or warns of it.
fn refuse(flaw: &str, force: bool) -> Outcome {
    if !force {
        return Err(Failure::difference(format!("{flaw}; `--force` writes the plan all the same")));
    }
    tell!("warning: {flaw}");
    Ok(())
}

fn print_agreement(quantised: &Quantised) {
    let Quantised { compiled: Compiled { report, .. }, exact, agreement } = quantised;
    say!(
        "same action on {:.3} % of {} recorded observations that no weight was rounded for, largest error of a utility {:.1e}",
        100.0 * agreement.share(),
        agreement.observations,
        agreement.max_utility_error
    );
    print_bytes(report, exact);
}

fn print_bytes(int8: &Report, exact: &Report) {
    let mut table = Table::new(&["bytes", "int8", "f32"]);
    let mut row = |name: &str, int8: usize, exact: usize| {
        table.row([name.to_string(), int8.to_string(), exact.to_string()]);
    };
    row("flash", int8.flash_bytes, exact.flash_bytes);
    row("arena", int8.arena_bytes, exact.arena_bytes);
    table.print();
}

fn refusal(error: &CompileError) -> Refusal<'_> {
    let message = error.to_string();
    match error {
        CompileError::Unsupported { node, operator, shapes, hint } => Refusal {
            message,
            node: Some(node),
            operator: Some(operator),
            shapes: Some(shapes),
            hint: Some(hint),
        },
        _ => Refusal { message, node: None, operator: None, shapes: None, hint: None },
    }
}

fn print(
    arguments: &CompileArguments,
    report: &Report,
    int8: Option<(&Agreement, &Report)>,
    paired: Option<&Paired>,
) {
    let plan = &arguments.output;
    if arguments.common.json {
        let (agreement, exact) = int8.unzip();
        print_json(&Written { plan, report, agreement, paired, exact });
        return;
    }
    say!(
        "{}: {} bytes of flash, {} bytes of arena, {} more for every further agent of a team",
        plan.display(),
        report.flash_bytes,
        report.arena_bytes,
        report.arena_bytes_per_agent
    );
    say!(
        "rounding {:.1}{}, on {} inputs, {} other actions",
        report.max_distance,
        if arguments.profile == PlanProfile::Int8 { "" } else { " of at most 16" },
        report.inputs,
        report.action_mismatches
    );
    print_operators(report);
}

fn print_operators(report: &Report) {
    let mut table = Table::new(&["operator", "sizes", "multiply-adds"]);
    for operator in &report.operators {
        let row = [operator.name.clone(), operator.detail.clone(), operator.macs.to_string()];
        table.row(row);
    }
    table.row(["all".to_string(), String::new(), report.macs.to_string()]);
    table.print();
}
