//! `bench policy`: a policy whoever exported it, as a plan and by the peers.

use std::path::PathBuf;

use clap::Args;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::foreign::PolicyArguments;
use sortie_cli::output::tell;
use sortie_cli::tools::{OnnxRuntimeArguments, compiler, engines};
use sortie_core::plan::{AlignedBytes, Profile};
use sortie_plans::{
    CompileError, CompileOptions, FlatPolicy, PlanFlatPolicy, PolicyFacts, PolicyOptions,
    random_policy_inputs, read_onnx,
};

use super::contestants::{PROFILES, floor_of};
use super::rounds::{Pace, alternate, engine, our_engine};
use super::{FLOOR, Figures, Measuring, TRACT_VERSION, if_runnable, pin};

/// Inputs in rotation.
const INPUTS: usize = 64;

/// Decisions of exported policies: our plans, tract, onnxruntime and the floor in alternation
///
/// Inputs are random, recurrent states are fed back. Every engine keeps its buffers from call to call. The floor only
/// reads the exact plan's weights, once.
#[derive(Debug, Args)]
pub(super) struct PolicyBenchArguments {
    /// ONNX files
    #[arg(required = true, value_name = "ONNX")]
    files: Vec<PathBuf>,
    /// What lies between two calls, several joined by commas
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [Pace::Hot])]
    pace: Vec<Pace>,
    #[command(flatten)]
    onnxruntime: OnnxRuntimeArguments,
    #[command(flatten)]
    pub(super) measuring: Measuring,
    // Last: what follows would stand under its heading.
    #[command(flatten)]
    policy: PolicyArguments,
}

pub(super) fn measure(arguments: &PolicyBenchArguments) -> Result<Figures, Failure> {
    let mut figures = Figures::default();
    for file in &arguments.files {
        let options = arguments.policy.options_for(file)?;
        let onnx = read_onnx(file).map_err(|error| Failure::file(file, &error))?;
        let name = file.file_stem().unwrap_or(file.as_os_str()).display().to_string();
        measure_one(arguments, &name, (&onnx, &options), &mut figures)
            .map_err(|failure| failure.within(file.display()))?;
    }
    Ok(figures)
}

fn measure_one(
    arguments: &PolicyBenchArguments,
    name: &str,
    (onnx, options): (&[u8], &PolicyOptions),
    figures: &mut Figures,
) -> Outcome {
    let plans = compile(onnx, options)?;
    let Some((_, exact, facts)) = plans.first() else { return Ok(()) };
    let floor = floor_of(exact.as_slice())?;
    let mut ours = Vec::new();
    for (profile, plan, facts) in &plans {
        let policy = PlanFlatPolicy::load(plan.as_slice(), facts.clone());
        ours.extend(if_runnable(profile, policy)?.map(|policy| (*profile, policy)));
    }
    let mut tract = engines()?.tract().flat_policy(onnx, options)?;
    let runtime = arguments.onnxruntime.open_or_note("onnxruntime is not measured")?;
    let peer = runtime.map(|runtime| runtime.flat_policy(onnx, options));
    let mut peer = peer.transpose()?;
    let inputs = random_policy_inputs(INPUTS, facts, arguments.measuring.common.seed);
    let mut inputs: Vec<Vec<&[f32]>> =
        inputs.iter().map(|given| given.iter().map(Vec::as_slice).collect()).collect();
    inputs.retain(|given| ours.iter_mut().all(|(_, policy)| is_answered(policy, given)));
    match inputs.len() {
        0 => {
            let reason = "no random input has an answer: nothing may be available, or a number is not finite";
            return Err(Failure::new(Exit::BadData, reason));
        }
        INPUTS => {}
        left => tell!(
            "note: {} of {INPUTS} random inputs have no answer, and are left out",
            INPUTS - left
        ),
    }
    pin(arguments.measuring.pin)?;
    let seconds = arguments.measuring.seconds / arguments.files.len() as f64;
    for pace in &arguments.pace {
        let mut engines = Vec::new();
        for (profile, policy) in &mut ours {
            engines.push(our_engine(profile, |call| step(policy, &inputs, call)));
        }
        engines.push(engine("tract", TRACT_VERSION, |call| step(tract.as_mut(), &inputs, call)));
        if let (Some(peer), Some(runtime)) = (&mut peer, runtime) {
            let version = runtime.version();
            engines.push(engine("onnxruntime", version, |call| step(peer.as_mut(), &inputs, call)));
        }
        engines.push(engine(FLOOR, "", |_| floor.read()));
        let seconds = seconds / arguments.pace.len() as f64;
        let measured = alternate(&mut engines, *pace, seconds);
        figures.add("policy", &format!("{name}, {}", pace.name()), &engines, &measured);
    }
    Ok(())
}

/// Whether a policy without memory of others has an answer to an input.
fn is_answered(policy: &mut dyn FlatPolicy, given: &[&[f32]]) -> bool {
    let mut states = vec![0.0; policy.facts().state_length()];
    policy.run(given, &mut states).is_ok()
}

/// A memory can lead to a refusal where none did: that is a call like others.
fn step(policy: &mut dyn FlatPolicy, inputs: &[Vec<&[f32]>], call: usize) {
    let _ = std::hint::black_box(policy.step(&inputs[call % inputs.len()]));
}

/// The plans of all profiles that the policy has, the exact one first.
fn compile(
    onnx: &[u8],
    policy: &PolicyOptions,
) -> Result<Vec<(&'static str, AlignedBytes, PolicyFacts)>, Failure> {
    let mut plans = Vec::new();
    for (name, profile) in PROFILES {
        let options = CompileOptions { profile, ..CompileOptions::default() };
        match compiler().compile_policy(onnx, policy, &options) {
            Ok(plan) => {
                plans.push((name, AlignedBytes::copy_of(&plan.compiled.bytes), plan.facts));
            }
            Err(CompileError::NoInt8 { .. }) if profile == Profile::Int8 => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(plans)
}
