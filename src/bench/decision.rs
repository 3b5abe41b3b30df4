//! One decision: our plan, tract, onnxruntime and the floor on the same observations.

use std::path::PathBuf;

use clap::Args;
use sortie_bundle::{Bundle, Recording};
use sortie_compiler::onnxruntime::{OnnxRuntime, OnnxRuntimePolicy};
use sortie_compiler::{CompileError, CompileOptions, compile};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{EntityMask, Observation, Policy};
use sortie_envs::save_the_city::ScenarioSet;

use super::floor::Floor;
use super::rounds::{Engine, Pace, alternate};
use super::{FLOOR, Figures, Measuring, OURS, TRACT_VERSION, pin, scenes, team};
use crate::deployment::open_bundle;
use crate::environment::ScenarioSetName;
use crate::failure::Failure;
use crate::observations::read_recording;
use crate::onnxruntime::OnnxRuntimeArguments;
use crate::policy::{Backend, DeployedPolicy};

/// The set with the largest teams that are measured.
const LARGE_SET: &str = "2-8a_2-8b";
/// Different observations of a case, which are taken in turn.
const OBSERVATIONS: usize = 256;
/// Entities of a frame whose mask is forced open.
const ALL: usize = 11;
/// Visible entities of the usual decision.
const FEW: usize = 4;

/// Decisions of a bundle's agent: the plan, tract, onnxruntime and the floor in alternation
///
/// Decides on observations of episodes that the bundle plays, or that were recorded: alone with everything
/// visible, with four entities and with the recorded masks, and as a team of five and of eight against one
/// batched call of onnxruntime. The floor only reads the plan's weights, once.
#[derive(Debug, Args)]
pub(super) struct DecisionArguments {
    /// Folder of the bundle
    #[arg(default_value = "models/save-the-city")]
    bundle: PathBuf,
    /// Observations of `sortie eval --dump` [default: episodes are played]
    #[arg(long, value_name = "FILE")]
    observations: Option<PathBuf>,
    /// What lies between two calls, several joined by commas
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = Pace::ALL)]
    pace: Vec<Pace>,
    #[command(flatten)]
    onnxruntime: OnnxRuntimeArguments,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

pub(super) fn measure(arguments: &DecisionArguments) -> Result<Figures, Failure> {
    let bundle = open_bundle(&arguments.bundle)?;
    let runtime = arguments.onnxruntime.open_or_note("onnxruntime is not measured");
    let plan = plan_for_large_teams(&bundle)?;
    let floor = floor_of(plan.as_slice())?;
    let mut ours = DeployedPolicy::of_plan(plan)?;
    let mut ours = ours.policy()?;
    let recordings = recordings(arguments, &bundle, ours.as_mut())?;
    let mut tract = DeployedPolicy::open(&bundle, Backend::Tract)?;
    let mut tract = tract.policy()?;
    let mut peer = runtime.map(|runtime| graph_policy(runtime, &bundle)).transpose()?;
    let version = runtime.map_or(String::new(), |runtime| runtime.version().to_owned());
    pin(arguments.measuring.pin)?;
    let mut figures = Figures::default();
    let cases = [all_visible(&recordings), few_visible(&recordings), recorded(&recordings)];
    let shares = cases.len() + team::SIZES.len();
    let seconds = |pace| arguments.measuring.seconds * share(pace) / shares as f64;
    for case in cases.iter().filter(|case| case.holds_any(&arguments.bundle)) {
        for pace in &arguments.pace {
            let mut engines = vec![engine(OURS, env!("CARGO_PKG_VERSION"), |call| {
                case.decide(ours.as_mut(), call)
            })];
            engines.push(engine("tract", TRACT_VERSION, |call| case.decide(tract.as_mut(), call)));
            if let Some(peer) = &mut peer {
                engines.push(engine("onnxruntime", &version, |call| case.decide(peer, call)));
            }
            engines.push(engine(FLOOR, "", |_| floor.read()));
            let measured = alternate(&mut engines, *pace, seconds(*pace));
            figures.add(
                "decision",
                &format!("{}, {}", case.name, pace.name()),
                &engines,
                &measured,
            );
        }
    }
    let contest =
        team::Contest { bundle: &bundle, runtime, floor: &floor, recordings: &recordings };
    team::measure(&contest, ours.as_mut(), &mut figures, &arguments.pace, &seconds)?;
    Ok(figures)
}

pub(super) fn engine<'a>(
    name: &'static str,
    version: &str,
    work: impl FnMut(usize) + 'a,
) -> Engine<'a> {
    Engine { name, version: version.to_owned(), work: Box::new(work) }
}

/// Hot calls are short and many; the others wait most of their time, and make three rounds at least.
fn share(pace: Pace) -> f64 {
    match pace {
        Pace::Hot => 0.6,
        Pace::Cold => 0.3,
        Pace::Spaced => 0.1,
    }
}

/// The bundle's network for more entities than it may have been exported for.
fn plan_for_large_teams(bundle: &Bundle) -> Result<AlignedBytes, Failure> {
    let large = ScenarioSet::named(LARGE_SET).map_err(Failure::bug)?;
    let large = large.max_agents + large.max_buildings;
    let options = CompileOptions {
        n_max: large.max(bundle.manifest().limits.n_max.into()),
        features: Some(bundle.contract().features.into()),
        ..CompileOptions::default()
    };
    let compiled = compile(bundle.agent_onnx(), &options);
    let failed = |error: CompileError| Failure::from(error).within(bundle.folder().display());
    compiled.map(|compiled| AlignedBytes::copy_of(&compiled.bytes)).map_err(failed)
}

fn floor_of(plan: &[u8]) -> Result<Floor, Failure> {
    let loaded = Plan::load(plan).map_err(CompileError::from)?;
    let header = loaded.header();
    let start = header.weights_offset as usize;
    let weights = plan.get(start..start + header.weights_len as usize);
    Ok(Floor::new(weights.unwrap_or_default()))
}

fn graph_policy(runtime: &OnnxRuntime, bundle: &Bundle) -> Result<OnnxRuntimePolicy, Failure> {
    let features = bundle.contract().features.into();
    OnnxRuntimePolicy::new(runtime, bundle.agent_onnx(), features)
        .map_err(|error| Failure::from(error).within(bundle.folder().display()))
}

/// The file that was named, else episodes of the bundle's own scenario set and of large teams.
fn recordings(
    arguments: &DecisionArguments,
    bundle: &Bundle,
    policy: &mut dyn Policy,
) -> Result<Vec<Recording>, Failure> {
    if let Some(file) = &arguments.observations {
        return Ok(vec![read_recording(file, bundle)?]);
    }
    let own = ScenarioSetName::parse(&bundle.manifest().contract.environment.name)?;
    let seed = arguments.measuring.common.seed;
    let mut record = |set: &str| scenes::record(bundle, policy, set, seed);
    Ok(vec![record(own.set())?, record(LARGE_SET)?])
}

/// Observations that are decided on in turn.
struct Case<'a> {
    name: String,
    observations: Vec<Observation<'a>>,
}

/// Frames of so many entities with the mask forced open: what is masked by subtask never shows as many.
fn all_visible(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().flat_map(Recording::observations);
    let full = observations.filter(|seen| seen.rows.len() == ALL * seen.stride);
    let open = full.map(|seen| Observation { visible: EntityMask::first(ALL), ..seen });
    Case { name: format!("N = {ALL}, all visible"), observations: some(open.collect()) }
}

/// Recorded masks that show so many entities.
fn few_visible(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().flat_map(Recording::observations);
    let few = observations.filter(|seen| seen.visible.len() == FEW);
    Case { name: format!("N = {FEW}"), observations: some(few.collect()) }
}

/// All recorded masks of the bundle's own scenario set.
fn recorded(recordings: &[Recording]) -> Case<'_> {
    let observations = recordings.iter().take(1).flat_map(Recording::observations);
    let observations = some(observations.collect());
    let visible: usize = observations.iter().map(|seen| seen.visible.len()).sum();
    let mean = visible as f64 / observations.len().max(1) as f64;
    Case { name: format!("recorded masks, {mean:.1} entities"), observations }
}

/// Some of many, from all parts of the episodes.
pub(super) fn some<T>(all: Vec<T>) -> Vec<T> {
    let step = (all.len() / OBSERVATIONS).max(1);
    all.into_iter().step_by(step).take(OBSERVATIONS).collect()
}

impl Case<'_> {
    fn holds_any(&self, bundle: &std::path::Path) -> bool {
        if self.observations.is_empty() {
            eprintln!("note: no observation of {} for `{}`", bundle.display(), self.name);
        }
        !self.observations.is_empty()
    }

    fn decide(&self, policy: &mut dyn Policy, call: usize) {
        let observation = &self.observations[call % self.observations.len()];
        let decision = policy.decide(observation);
        std::hint::black_box(decision.expect("observations of episodes can be decided on"));
    }
}
