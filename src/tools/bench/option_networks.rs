//! The networks of an agent that runs options: within an option, and where it chooses anew.

use sortie_bundle::{Bundle, OptionsContract};
use sortie_core::options::{OptionNetworks, Shown};
use sortie_core::plan::Profile;
use sortie_plans::{CompileError, GraphNetworks, option_arena, option_networks};

use super::rounds::{Work, alternate, engine, our_engine};
use super::schedule::Schedule;
use super::{Figures, OURS, TRACT_VERSION, pin};
use sortie_cli::compiler::plans;
use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::onnxruntime::OnnxRuntimeArguments;
use sortie_cli::policy::option_graphs;
use sortie_cli::tools::engines;

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
pub(super) fn measure(
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
