//! `bench policy`: a policy whoever exported it, as a plan and by the peers.

use std::path::PathBuf;

use clap::Args;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::foreign::PolicyArguments;
use sortie_cli::output::tell;
use sortie_cli::tools::{OnnxRuntimeArguments, compiler, engines};
use sortie_core::plan::{AlignedBytes, Profile};
use sortie_plans::{
    CompileError, CompileOptions, FlatPolicy, OnnxRuntimeEngine, PlanFlatPolicy, PolicyFacts,
    PolicyOptions, random_policy_inputs, read_onnx,
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

/// One policy, and how long each pace between calls is measured.
pub(super) struct Contest<'a> {
    pub(super) what: &'static str,
    pub(super) name: &'a str,
    pub(super) onnx: &'a [u8],
    pub(super) options: &'a PolicyOptions,
    pub(super) paces: &'a [Pace],
    pub(super) seconds: f64,
}

pub(super) fn measure(arguments: &PolicyBenchArguments) -> Result<Figures, Failure> {
    let PolicyBenchArguments { files, pace: paces, onnxruntime, measuring, policy } = arguments;
    let runtime = onnxruntime.open_or_note("onnxruntime is not measured")?;
    let mut figures = Figures::default();
    for file in files {
        let options = policy.options_for(file)?;
        let onnx = read_onnx(file).map_err(|error| Failure::file(file, &error))?;
        let name = file.file_stem().unwrap_or(file.as_os_str()).display().to_string();
        let seconds = measuring.seconds / (files.len() * paces.len()) as f64;
        let contest =
            Contest { what: "policy", name: &name, onnx: &onnx, options: &options, paces, seconds };
        measure_one(&contest, runtime, measuring, &mut figures)
            .map_err(|failure| failure.within(file.display()))?;
    }
    Ok(figures)
}

/// The plans of a policy, its peers and the floor in alternation.
pub(super) fn measure_one(
    contest: &Contest<'_>,
    runtime: Option<&dyn OnnxRuntimeEngine>,
    measuring: &Measuring,
    figures: &mut Figures,
) -> Outcome {
    let Contest { what, name, onnx, options, paces, seconds } = *contest;
    let plans = compile(onnx, options)?;
    let Some((_, exact, facts)) = plans.first() else { return Ok(()) };
    let floor = floor_of(exact.as_slice())?;
    let mut ours = Vec::new();
    for (profile, plan, facts) in &plans {
        let policy = PlanFlatPolicy::load(plan.as_slice(), facts.clone());
        ours.extend(if_runnable(profile, policy)?.map(|policy| (*profile, policy)));
    }
    let mut tract = engines()?.tract().flat_policy(onnx, options)?;
    let peer = runtime.map(|runtime| runtime.flat_policy(onnx, options));
    let mut peer = peer.transpose()?;
    let inputs = random_policy_inputs(INPUTS, facts, measuring.common.seed);
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
    pin(measuring.pin)?;
    for pace in paces {
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
        let measured = alternate(&mut engines, *pace, seconds);
        figures.add(what, &format!("{name}, {}", pace.name()), &engines, &measured);
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
