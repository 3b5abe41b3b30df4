//! Who decides in a benchmark: a bundle's plans in every profile, tract, onnxruntime and the floor.

use std::fs;
use std::path::Path;
use std::process::Command;

use sortie_bundle::{Bundle, POLICY};
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::Failure;
use sortie_cli::output::tell;
use sortie_cli::policy::{Backend, DeployedPolicy, graph_policy};
use sortie_cli::tools::{OnnxRuntimeArguments, compiler, plans};
use sortie_core::Policy;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_envs::Split;
use sortie_plans::{
    AgentPlans, BatchedUtilities, CompileError, CompileOptions, Compiler, OnnxRuntimeEngine,
};

use super::scenes::large_set;
use super::{FUSED, OURS, if_runnable};

/// The profiles of our plans, and what their engines are called.
pub(super) const PROFILES: [(&str, Profile); 3] =
    [(OURS, Profile::Exact), (FUSED, Profile::Fused), ("sortie int8", Profile::Int8)];

/// All engines of one bundle.
pub(super) struct Contestants<'b> {
    pub(super) bundle: &'b Bundle,
    /// The folder's own name.
    pub(super) name: String,
    /// Our plans; the first is of the profile `exact`.
    pub(super) ours: Vec<(&'static str, DeployedPolicy)>,
    pub(super) tract: DeployedPolicy,
    pub(super) onnxruntime: Option<OnnxRuntimePeer>,
    pub(super) floor: Floor,
}

/// The peer's sessions.
pub(super) struct OnnxRuntimePeer {
    pub(super) runtime: &'static dyn OnnxRuntimeEngine,
    pub(super) alone: Box<dyn Policy>,
    /// The same network quantised by onnxruntime.
    pub(super) quantised: Option<Box<dyn Policy>>,
    /// None for policies of others, which take one agent's row.
    pub(super) team: Option<Box<dyn BatchedUtilities>>,
}

impl<'b> Contestants<'b> {
    /// Compiles the bundle's network in every profile that this machine has.
    pub(super) fn open(
        bundle: &'b Bundle,
        onnxruntime: &OnnxRuntimeArguments,
    ) -> Result<Self, Failure> {
        let folder = bundle.folder();
        let within = |error: CompileError| Failure::from(error).within(folder.display());
        let mut ours = Vec::new();
        let mut floor = None;
        for (name, profile) in PROFILES {
            let plans = plans_for_large_teams(bundle, profile)?;
            if let (Profile::Exact, Some(plan)) = (profile, plans.plans().first()) {
                floor = Some(floor_of(plan.as_slice()).map_err(within)?);
            }
            let policy = if_runnable(name, DeployedPolicy::of_plans(plans)).map_err(within)?;
            ours.extend(policy.map(|policy| (name, policy)));
        }
        let runtime = onnxruntime.open_or_note("onnxruntime is not measured")?;
        let peer = runtime.map(|runtime| {
            OnnxRuntimePeer::open(runtime, onnxruntime.python(), bundle).map_err(within)
        });
        Ok(Self {
            bundle,
            name: folder.file_name().unwrap_or(folder.as_os_str()).display().to_string(),
            ours,
            tract: DeployedPolicy::open(bundle, Backend::Tract)?,
            onnxruntime: peer.transpose()?,
            floor: floor.expect("the exact profile is among ours"),
        })
    }

    /// Our policy of the default profile.
    pub(super) fn first(&mut self) -> Result<Box<dyn Policy + '_>, Failure> {
        let (_, exact) = self.ours.first_mut().expect("every machine runs the exact profile");
        Ok(exact.team()?)
    }
}

impl OnnxRuntimePeer {
    fn open(
        runtime: &'static dyn OnnxRuntimeEngine,
        python: Option<&Path>,
        bundle: &Bundle,
    ) -> Result<Self, CompileError> {
        let features = bundle.contract().features.into();
        let onnx = bundle.agent_onnx();
        let alone = graph_policy(bundle, runtime)?;
        if takes_fixed_sizes(bundle) {
            return Ok(Self { runtime, alone, quantised: None, team: None });
        }
        let quantised = quantise_or_note(python, onnx)
            .map(|variant| runtime.policy_of_variant(onnx, &variant, features));
        // Graphs that point are not rewritten for many agents at once.
        let noted = |error| tell!("note: onnxruntime is not measured with teams: {error}");
        let team = runtime.batched_agents(onnx, features).map_err(noted).ok();
        Ok(Self { runtime, alone, quantised: quantised.transpose()?, team })
    }
}

/// Whether its networks take inputs of fixed sizes.
fn takes_fixed_sizes(bundle: &Bundle) -> bool {
    bundle.manifest().network.agent == POLICY || bundle.options().is_some()
}

/// The bundle's networks for more entities than they may have been exported for; what takes inputs of fixed sizes is
/// as it is.
fn plans_for_large_teams(bundle: &Bundle, profile: Profile) -> Result<AgentPlans, Failure> {
    let failed = |error: CompileError| Failure::from(error).within(bundle.folder().display());
    let own = ScenarioSetName::parse(&bundle.manifest().contract.environment.name)?;
    let large = large_set(&own).filter(|_| !takes_fixed_sizes(bundle));
    let Some(large) = large else { return plans().agents(bundle, profile).map_err(failed) };
    let large = large.open(Split::Test)?.spec().shape.entities;
    let options = CompileOptions {
        n_max: large.max(bundle.manifest().limits.n_max.into()),
        features: Some(bundle.contract().features.into()),
        profile,
        ..CompileOptions::default()
    };
    let compiled = compiler().compile(bundle.agent_onnx(), &options).map_err(failed)?;
    Ok(AgentPlans::new(bundle, vec![AlignedBytes::copy_of(&compiled.bytes)]))
}

pub(super) fn floor_of(plan: &[u8]) -> Result<Floor, CompileError> {
    let loaded = Plan::load(plan)?;
    let header = loaded.header();
    let start = header.weights_offset as usize;
    let weights = plan.get(start..start + header.weights_len as usize);
    Ok(Floor::new(weights.unwrap_or_default()))
}

/// Bytes that memory hands over at once.
const CACHE_LINE: usize = 64;
/// Lines read side by side, so that one addition need not wait for the last.
const LANES: usize = 16;

/// The bytes of a plan's weights, aligned as in the plan.
pub(super) struct Floor(AlignedBytes);

impl Floor {
    fn new(weights: &[u8]) -> Self {
        Self(AlignedBytes::copy_of(weights))
    }

    /// Reads one word of every cache line: no arithmetic could need less.
    pub(super) fn read(&self) {
        std::hint::black_box(self.sum());
    }

    fn sum(&self) -> u64 {
        let mut sums = [0_u64; LANES];
        for lines in self.0.as_slice().as_chunks::<CACHE_LINE>().0.chunks(LANES) {
            for (sum, line) in sums.iter_mut().zip(lines) {
                let word = line.first_chunk().map_or(0, |word| u64::from_le_bytes(*word));
                *sum = sum.wrapping_add(word);
            }
        }
        sums.iter().fold(0, |total, sum| total.wrapping_add(*sum))
    }
}

const PROGRAM: &str = include_str!("../../../benches/quantise.py");

/// Quantises a network, or notes why it cannot be.
fn quantise_or_note(python: Option<&Path>, onnx: &[u8]) -> Option<Vec<u8>> {
    let Some(python) = python else {
        tell!("note: onnxruntime int8 is not measured: `--python` names no interpreter");
        return None;
    };
    quantise(python, onnx)
        .inspect_err(|Failure { message, .. }| {
            tell!("note: onnxruntime int8 is not measured: {message}");
        })
        .ok()
}

fn quantise(python: &Path, onnx: &[u8]) -> Result<Vec<u8>, Failure> {
    let folder = tempfile::tempdir().map_err(Failure::bug)?;
    let [program, network, quantised] =
        ["quantise.py", "network.onnx", "quantised.onnx"].map(|name| folder.path().join(name));
    fs::write(&program, PROGRAM).map_err(|error| Failure::file(&program, &error))?;
    fs::write(&network, onnx).map_err(|error| Failure::file(&network, &error))?;
    let ran = Command::new(python)
        .args([&program, &network, &quantised])
        .output()
        .map_err(|error| Failure::file(python, &error))?;
    if !ran.status.success() {
        let words = String::from_utf8_lossy(&ran.stderr);
        let last = words.lines().last().unwrap_or("it says nothing");
        let message = format!("{last}; `{} -m pip install onnx` may help", python.display());
        return Err(Failure::difference(message));
    }
    fs::read(&quantised).map_err(|error| Failure::file(&quantised, &error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cache_line_is_read() {
        let lines = 0..LANES as u64 * 3 + 1;
        let words = lines.clone().flat_map(|line| [line * line, 9, 9, 9, 9, 9, 9, 9]);
        let bytes: Vec<u8> = words.flat_map(u64::to_le_bytes).collect();
        let want: u64 = lines.map(|line| line * line).sum();
        assert_eq!(Floor::new(&bytes).sum(), want);
    }
}
