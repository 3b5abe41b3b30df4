//! Decisions: our plans, tract, onnxruntime and the floor on the same observations.

use std::path::PathBuf;

use clap::Args;
use sortie_bundle::{Bundle, OptionsContract, RecordedFrame, Recording};
use sortie_cli::deployment::open_bundle;
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::output::tell;
use sortie_cli::policy::option_graphs;
use sortie_cli::remake::read_observations;
use sortie_cli::tools::{OnnxRuntimeArguments, engines, plans};
use sortie_core::choose::masked_argmax;
use sortie_core::options::{OptionNetworks, Shown};
use sortie_core::plan::Profile;
use sortie_core::{DecideError, Observation, Policy};
use sortie_plans::{
    BatchedUtilities, CompileError, GraphNetworks, TOLERANCE, option_arena, option_networks,
};

use super::contestants::Contestants;
use super::rounds::{Pace, Schedule, Work, alternate, engine, our_engine};
use super::scenes::{self, Case, all_visible, few_visible, recorded, some};
use super::{FLOOR, Figures, Measuring, OURS, TRACT_VERSION, pin};

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
            measure_options(own, &bundle, options, &schedule(arguments), &mut figures)?;
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
        measure_teams(&mut contestants, &recordings, &schedule, &mut figures)?;
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
    let cases = arguments.bundles.len() * (CASES_ALONE + SIZES.len());
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
        return Ok(vec![read_observations(file, bundle)?]);
    }
    let own = ScenarioSetName::parse(&bundle.manifest().contract.environment.name)?;
    let seed = arguments.measuring.common.seed;
    if !own.has_subtasks()? {
        return Ok(vec![scenes::record_without_subtasks(bundle, policy, &own, seed)?]);
    }
    let large = scenes::large_set(&own);
    let sets = std::iter::once(own).chain(large);
    sets.map(|set| scenes::record(bundle, policy, &set, seed)).collect()
}

/// What is decided on: rows of golden episodes, and what is shown of them.
struct Seen {
    rows: Vec<Vec<f32>>,
    shown: Vec<Vec<f32>>,
    goals: Vec<usize>,
    step: Shown,
}

impl Seen {
    fn of(bundle: &Bundle, options: &OptionsContract) -> Result<Self, CompileError> {
        let unfit = |reason: String| CompileError::NoAgent { reason };
        let features = bundle.contract().features;
        let step = options.shown().map_err(unfit)?;
        let ticks = || bundle.golden().episodes.iter().flat_map(|episode| &episode.ticks);
        let rows = ticks().map(|tick| tick.row(features.into()).map_err(unfit));
        let rows: Vec<Vec<f32>> = rows.collect::<Result<_, _>>()?;
        let goals = ticks().map(|tick| tick.goal.into()).collect();
        let mut seen = Self { rows, shown: Vec::new(), goals, step };
        for index in 0..seen.rows.len() {
            let mut shown = vec![0.0; seen.step.columns()];
            seen.show(index, &mut shown);
            seen.shown.push(shown);
        }
        Ok(seen)
    }

    /// The feature step.
    fn show(&self, call: usize, to: &mut [f32]) {
        let view = self.step.lay_out(&self.rows[call % self.rows.len()], to);
        std::hint::black_box(view);
    }
}

/// The two kinds of ticks.
#[derive(Clone, Copy)]
enum Tick {
    /// The controller for one goal.
    Within,
    /// Affordances, the meta-controller, and the controller.
    Boundary,
}

/// Measures a bundle's networks beside the peers'.
fn measure_options(
    (onnxruntime, core): (&OnnxRuntimeArguments, usize),
    bundle: &Bundle,
    options: &OptionsContract,
    schedule: &Schedule<'_>,
    figures: &mut Figures,
) -> Outcome {
    let within = |error: CompileError| Failure::from(error).within(bundle.folder().display());
    let seen = Seen::of(bundle, options).map_err(within)?;
    let found = plans().agents(bundle, Profile::Exact).map_err(within)?;
    let fits = |error| within(CompileError::from(error));
    let mut arena = option_arena(found.plans()).map_err(fits)?;
    let mut ours = option_networks(found.plans(), &mut arena).map_err(fits)?;
    let tract = option_graphs(bundle, engines()?.tract()).map_err(within)?;
    let mut tract = GraphNetworks(tract);
    let runtime = onnxruntime.open_or_note("onnxruntime is not measured")?;
    let peer = runtime.map(|runtime| {
        option_graphs(bundle, runtime).map(|graphs| (runtime.version(), GraphNetworks(graphs)))
    });
    let mut peer = peer.transpose().map_err(within)?;
    pin(core)?;
    let name = bundle.folder().file_name().unwrap_or_default().display();
    let sizes = [usize::from(bundle.contract().actions), options.milestones.len()];
    for pace in schedule.paces {
        for (tick, about) in
            [(Tick::Within, "the controller, one goal"), (Tick::Boundary, "an option begins")]
        {
            let mut engines = vec![our_engine(OURS, work(&mut ours, &seen, tick, sizes))];
            engines.push(engine("tract", TRACT_VERSION, work(&mut tract, &seen, tick, sizes)));
            if let Some((version, peer)) = &mut peer {
                engines.push(engine("onnxruntime", version, work(peer, &seen, tick, sizes)));
            }
            let measured = alternate(&mut engines, *pace, schedule.seconds(*pace));
            let case = format!("{name}: {about}, {}", pace.name());
            figures.add("decision", &case, &engines, &measured);
        }
        let mut shown = vec![0.0; seen.step.columns()];
        let mut engines = [our_engine(OURS, |call| {
            seen.show(call, &mut shown);
            std::hint::black_box(&mut shown);
        })];
        let measured = alternate(&mut engines, *pace, schedule.seconds(*pace));
        let case = format!("{name}: what the networks are shown, {}", pace.name());
        figures.add("decision", &case, &engines, &measured);
    }
    Ok(())
}

/// The networks of a tick on what was shown.
fn work<'a>(
    networks: &'a mut dyn OptionNetworks,
    seen: &'a Seen,
    tick: Tick,
    [actions, goals]: [usize; 2],
) -> Work<'a> {
    let (mut values, mut of_goals) = (vec![0.0; actions], vec![0.0; goals]);
    Box::new(move |call| {
        let index = call % seen.shown.len();
        let shown = &seen.shown[index];
        let mut all = || {
            if matches!(tick, Tick::Boundary) {
                networks.affordances(shown, &mut of_goals)?;
                networks.goals(shown, &mut of_goals)?;
            }
            networks.actions(shown, seen.goals[index], &mut values)
        };
        all().expect("golden observations can be decided on");
        std::hint::black_box(&values);
    })
}

/// Agents, and entities of their frames.
const SIZES: [(usize, usize); 2] = [(5, 11), (8, 17)];
/// Agents of the largest team.
const LARGEST: usize = 8;

/// Measures teams of all sizes on recorded masks.
fn measure_teams(
    contestants: &mut Contestants<'_>,
    recordings: &[Recording],
    schedule: &Schedule<'_>,
    figures: &mut Figures,
) -> Outcome {
    for (agents, entities) in SIZES {
        let frames = frames(recordings, agents, entities);
        let case = format!("{}: {agents} agents, N = {entities}", contestants.name);
        if frames.is_empty() {
            tell!("note: no frame of `{case}` was recorded");
            continue;
        }
        check(&frames, contestants)?;
        measure_team(contestants, &case, &frames, schedule, figures)?;
    }
    Ok(())
}

/// Measures all decisions of a frame in one call of each engine.
fn measure_team(
    contestants: &mut Contestants<'_>,
    case: &str,
    frames: &[Vec<Observation<'_>>],
    schedule: &Schedule<'_>,
    figures: &mut Figures,
) -> Outcome {
    let agents = frames.first().map_or(0, Vec::len);
    let actions = usize::from(contestants.bundle.contract().actions);
    let Contestants { ours, onnxruntime, floor, .. } = contestants;
    let mut plans = Vec::new();
    for (profile, plan) in ours {
        plans.push((*profile, plan.team()?));
    }
    let mut utilities = vec![0.0; agents * actions];
    let frame = |call: usize| &frames[call % frames.len()];
    for pace in schedule.paces {
        let mut engines = Vec::new();
        for (profile, policy) in &mut plans {
            engines.push(our_engine(profile, |call| decide_together(frame(call), policy.as_mut())));
        }
        if let Some(peer) = onnxruntime
            && let Some(team) = &mut peer.team
        {
            let utilities = &mut utilities;
            let at_once = |call| at_once(frame(call), team.as_mut(), utilities);
            engines.push(engine("onnxruntime", peer.runtime.version(), at_once));
        }
        engines.push(engine(FLOOR, "", |_| floor.read()));
        let measured = alternate(&mut engines, *pace, schedule.seconds(*pace));
        figures.add("team", &format!("{case}, {}", pace.name()), &engines, &measured);
    }
    Ok(())
}

/// The frames in which so many agents decide among so many entities.
fn frames(recordings: &[Recording], agents: usize, entities: usize) -> Vec<Vec<Observation<'_>>> {
    let of = |recording: &Recording, frame: &RecordedFrame| {
        frame.agents.len() == agents && frame.entities(recording.features) == entities
    };
    let all = recordings.iter().flat_map(|recording| {
        let fits = recording.frames.iter().filter(move |frame| of(recording, frame));
        fits.map(|frame| frame.observations(recording.features).collect())
    });
    some(all.collect())
}

/// The decisions of all agents in one call.
fn decide_together(frame: &[Observation<'_>], policy: &mut dyn Policy) {
    let mut decisions = [Err(DecideError::BadLength); LARGEST];
    policy.decide_batch(frame, &mut decisions);
    for decision in decisions.iter().take(frame.len()) {
        std::hint::black_box(decision.expect("observations of episodes can be decided on"));
    }
}

/// One call for all agents, and the choice of each.
fn at_once(frame: &[Observation<'_>], peer: &mut dyn BatchedUtilities, utilities: &mut [f32]) {
    peer.utilities(frame, utilities).expect("the batched graph takes every recorded frame");
    let actions = utilities.len() / frame.len().max(1);
    for (observation, utilities) in frame.iter().zip(utilities.chunks_exact(actions)) {
        let decision = masked_argmax(utilities, observation.available);
        std::hint::black_box(decision.expect("an action is available"));
    }
}

/// The batched graph must compute what the single one does, which our plan was proved against.
fn check(frames: &[Vec<Observation<'_>>], contestants: &mut Contestants<'_>) -> Outcome {
    let Contestants { ours, onnxruntime: Some(peer), .. } = contestants else { return Ok(()) };
    let Some(team) = &mut peer.team else { return Ok(()) };
    let (_, exact) = ours.first_mut().expect("every machine runs the exact profile");
    let mut ours = exact.policy()?;
    let actions = ours.actions();
    let mut want = vec![0.0; actions];
    for frame in frames {
        let mut got = vec![0.0; frame.len() * actions];
        team.utilities(frame, &mut got)
            .map_err(|error| Failure::difference(format!("the batched graph: {error}")))?;
        for (observation, got) in frame.iter().zip(got.chunks_exact(actions)) {
            ours.utilities(observation, &mut want)
                .map_err(|error| Failure::difference(format!("the plan: {error}")))?;
            let largest = want.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
            let distance = got.iter().zip(&want).map(|(got, want)| (got - want).abs());
            let error = distance.fold(0.0, f32::max) / (1.0 + largest);
            if error.is_nan() || error > TOLERANCE {
                let message =
                    format!("the batched graph differs from the single one by {error:.1e}");
                return Err(Failure::difference(message));
            }
        }
    }
    Ok(())
}
