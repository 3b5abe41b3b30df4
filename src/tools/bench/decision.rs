//! Decisions: our plans, tract, onnxruntime and the floor on the same observations.

use std::path::PathBuf;

use clap::Args;
use sortie_bundle::{Bundle, Recording};
use sortie_core::Policy;

use super::cases::{Case, all_visible, few_visible, recorded};
use super::contestants::Contestants;
use super::rounds::{Pace, alternate, engine, our_engine};
use super::schedule::Schedule;
use super::{FLOOR, Figures, Measuring, TRACT_VERSION, option_networks, pin, scenes, team};
use sortie_cli::deployment::open_bundle;
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::observations::read_recording;
use sortie_cli::onnxruntime::OnnxRuntimeArguments;

/// Decisions of bundles' agents: our plans, tract, onnxruntime and the floor in alternation
///
/// Decides on observations of episodes that the bundle plays, or that were recorded: alone with everything
/// visible, with four entities and with the recorded masks, and as a team of five and of eight in one call
/// against one batched call of onnxruntime. An agent that runs options is measured network by network, on its golden
/// episodes. The floor only reads the exact plan's weights, once.
#[derive(Debug, Args)]
pub(super) struct DecisionArguments {
    /// Folders of bundles
    #[arg(default_values = ["models/save-the-city-wide", "models/save-the-city"])]
    bundles: Vec<PathBuf>,
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
    let mut figures = Figures::default();
    for folder in &arguments.bundles {
        let bundle = open_bundle(folder)?;
        if let Some(options) = bundle.options() {
            let own = (&arguments.onnxruntime, arguments.measuring.pin);
            option_networks::measure(own, &bundle, options, &schedule(arguments), &mut figures)?;
            continue;
        }
        let mut contestants = Contestants::open(&bundle, &arguments.onnxruntime)?;
        let recordings = recordings(arguments, &bundle, contestants.first()?.as_mut())?;
        pin(arguments.measuring.pin)?;
        let schedule = schedule(arguments);
        let cases = [all_visible(&recordings), few_visible(&recordings), recorded(&recordings)];
        let name = contestants.name.clone();
        for case in cases.iter().filter(|case| case.holds_any(&name)) {
            alone(&mut contestants, case, &schedule, &mut figures)?;
        }
        team::measure(&mut contestants, &recordings, &schedule, &mut figures)?;
    }
    Ok(figures)
}

/// Measures decisions of one agent.
fn alone(
    contestants: &mut Contestants<'_>,
    case: &Case<'_>,
    schedule: &Schedule<'_>,
    figures: &mut Figures,
) -> Outcome {
    let Contestants { name, ours, tract, onnxruntime, floor, .. } = contestants;
    let mut plans = Vec::new();
    for (profile, plan) in ours {
        plans.push((*profile, plan.team()?));
    }
    let mut tract = tract.team()?;
    for pace in schedule.paces {
        let mut engines = Vec::new();
        for (profile, policy) in &mut plans {
            engines.push(our_engine(profile, |call| case.decide(policy.as_mut(), call)));
        }
        engines.push(engine("tract", TRACT_VERSION, |call| case.decide(tract.as_mut(), call)));
        if let Some(peer) = onnxruntime {
            let version = peer.runtime.version();
            engines.push(engine("onnxruntime", version, |call| {
                case.decide(peer.alone.as_mut(), call)
            }));
            if let Some(peer) = &mut peer.quantised {
                engines.push(engine("onnxruntime int8", version, |call| {
                    case.decide(peer.as_mut(), call)
                }));
            }
        }
        engines.push(engine(FLOOR, "", |_| floor.read()));
        let measured = alternate(&mut engines, *pace, schedule.seconds(*pace));
        let case = format!("{name}: {}, {}", case.name, pace.name());
        figures.add("decision", &case, &engines, &measured);
    }
    Ok(())
}

fn schedule(arguments: &DecisionArguments) -> Schedule<'_> {
    const CASES_ALONE: usize = 3;
    let cases = arguments.bundles.len() * (CASES_ALONE + team::SIZES.len());
    let seconds_per_case = arguments.measuring.seconds / cases as f64;
    Schedule { paces: &arguments.pace, seconds_per_case }
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
    if !own.has_subtasks()? {
        return Ok(vec![scenes::record_without_subtasks(bundle, policy, &own, seed)?]);
    }
    let large = scenes::large_set(&own)?;
    let mut record = |set| scenes::record(bundle, policy, set, seed);
    Ok(vec![record(&own)?, record(&large)?])
}
