//! Instructions of decisions under Callgrind: the same for the same program, whatever else the machine does.
//!
//! Counted are 60 decisions on observations of the bundle's golden answers. Callgrind knows AVX2 but not AVX-512. Plans
//! decide, not policies, which look at the clock: under Callgrind every decision comes after a long pause.

use std::hint::black_box;
use std::path::Path;

use gungraun::prelude::*;
use gungraun::{Callgrind, EventKind};
use sortie_bundle::{Bundle, OwnedObservation};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{DecideError, Decision, EntityMask, Observation};

/// Variables that name the bundle's folder, and that of its plans `exact.plan` and so on.
const BUNDLE: &str = "SORTIE_BUNDLE";
const PLANS: &str = "SORTIE_PLANS";
/// Decisions of a benchmark.
const DECISIONS: usize = 60;
/// Entities of the frames that are decided on, and agents of a team.
const ENTITIES: usize = 11;
const TEAM: usize = 5;

/// A plan that is loaded, and what it decides on: nothing of this is counted.
struct Scene {
    plan: Plan<'static>,
    arena: AlignedBytes,
    observations: Vec<Observation<'static>>,
}

/// What the agents of the observations see.
#[derive(Clone, Copy)]
enum Sight {
    /// All entities.
    Everything,
    /// As recorded, where that is four entities.
    Four,
    /// All entities, and every frame is seen by each agent of a team.
    Team,
}

fn scene(profile: &str, sight: Sight) -> Scene {
    let variable = |name: &str| std::env::var(name).expect("`.ci/count` sets it");
    let bundle = Bundle::open(Path::new(&variable(BUNDLE))).expect("a shipped bundle");
    let plan = Path::new(&variable(PLANS)).join(profile).with_extension("plan");
    let plan = Box::leak(Box::new(AlignedBytes::copy_of(&std::fs::read(plan).expect("a plan"))));
    let plan = Plan::load(plan.as_slice()).expect("a plan of this version");
    let arena = AlignedBytes::zeroed(plan.batch_arena_bytes(TEAM));
    let seen = Vec::leak(seen(&bundle, sight));
    assert!(!seen.is_empty(), "golden answers with frames of {ENTITIES} entities");
    Scene {
        plan,
        arena,
        observations: seen.iter().cycle().take(DECISIONS).map(OwnedObservation::view).collect(),
    }
}

fn seen(bundle: &Bundle, sight: Sight) -> Vec<OwnedObservation> {
    let golden = bundle.golden().cases.iter().map(|case| case.observation.clone());
    let full = golden.filter(|seen| seen.entities() == ENTITIES);
    let open = |seen| OwnedObservation { visible: EntityMask::first(ENTITIES), ..seen };
    match sight {
        Sight::Everything | Sight::Team => full.map(open).collect(),
        Sight::Four => full.filter(|seen| seen.visible.len() == 4).collect(),
    }
}

/// The same frame through the eyes of every agent of a team.
fn team(frame: Observation<'_>) -> [Observation<'_>; TEAM] {
    std::array::from_fn(|self_index| Observation { self_index, ..frame })
}

/// One percent more than was counted fails.
fn at_most(instructions_per_decision: u64) -> LibraryBenchmarkConfig {
    let limit = instructions_per_decision * DECISIONS as u64 * 101 / 100;
    let mut callgrind = Callgrind::with_args(["--cache-sim=no"]);
    callgrind.hard_limits([(EventKind::Ir, limit)]);
    let mut config = LibraryBenchmarkConfig::default();
    config.pass_through_envs([BUNDLE, PLANS]).tool(callgrind);
    config
}

#[library_benchmark]
#[bench::exact_everything(args = ("exact", Sight::Everything), config = at_most(39_944), setup = scene)]
#[bench::exact_four(args = ("exact", Sight::Four), config = at_most(28_953), setup = scene)]
#[bench::fused_everything(args = ("fused", Sight::Everything), config = at_most(29_816), setup = scene)]
#[bench::int8_everything(args = ("int8", Sight::Everything), config = at_most(53_245), setup = scene)]
#[bench::int8_four(args = ("int8", Sight::Four), config = at_most(37_682), setup = scene)]
#[bench::fused_four(args = ("fused", Sight::Four), config = at_most(20_797), setup = scene)]
fn alone(scene: Scene) {
    let Scene { plan, mut arena, observations } = scene;
    for observation in &observations {
        let _ = black_box(plan.decide(arena.as_mut_slice(), observation, None));
    }
}

#[library_benchmark]
#[bench::exact(args = ("exact", Sight::Team), config = at_most(45_998), setup = scene)]
#[bench::fused(args = ("fused", Sight::Team), config = at_most(34_872), setup = scene)]
#[bench::int8(args = ("int8", Sight::Team), config = at_most(40_353), setup = scene)]
fn together(scene: Scene) {
    let Scene { plan, mut arena, observations } = scene;
    let mut decisions: [Result<Decision, DecideError>; TEAM] = [Err(DecideError::BadLength); TEAM];
    for frame in observations.iter().take(DECISIONS / TEAM) {
        plan.decide_batch(arena.as_mut_slice(), &team(*frame), None, &mut decisions);
        let _ = black_box(&decisions);
    }
}

library_benchmark_group!(name = decisions, benchmarks = [alone, together]);
main!(library_benchmark_groups = decisions);
