//! Decides under Callgrind, which counts instructions: the same for the same program, whatever else the machine does.
//!
//!     instructions BUNDLE PLANS PROFILE SIGHT
//!
//! Counted is what [`counted_alone`] and [`counted_together`] do: 60 decisions on observations of the bundle's golden answers. PLANS is
//! a folder of plans `exact.plan` and so on. Callgrind knows AVX2 but not AVX-512. Plans decide, not policies, which look at the
//! clock: under Callgrind every decision comes after a long pause.

use std::error::Error;
use std::hint::black_box;
use std::path::Path;

use sortie_bundle::{Bundle, OwnedObservation};
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{DecideError, Decision, EntityMask, Observation};

/// Decisions that are counted.
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

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [bundle, plans, profile, sight] = arguments.as_slice() else {
        return Err("usage: instructions BUNDLE PLANS PROFILE everything|four|team".into());
    };
    let sight = match sight.as_str() {
        "everything" => Sight::Everything,
        "four" => Sight::Four,
        "team" => Sight::Team,
        other => return Err(format!("nobody sees `{other}`").into()),
    };
    let plan = Path::new(plans).join(profile).with_extension("plan");
    let mut scene = scene(&Bundle::open(Path::new(bundle))?, &plan, sight)?;
    match sight {
        Sight::Everything | Sight::Four => counted_alone(&mut scene),
        Sight::Team => counted_together(&mut scene),
    }
    Ok(())
}

fn scene(bundle: &Bundle, plan: &Path, sight: Sight) -> Result<Scene, Box<dyn Error>> {
    let plan = Box::leak(Box::new(AlignedBytes::copy_of(&std::fs::read(plan)?)));
    let plan = Plan::load(plan.as_slice())?;
    let arena = AlignedBytes::zeroed(plan.batch_arena_bytes(TEAM));
    let seen = Vec::leak(seen(bundle, sight));
    if seen.is_empty() {
        return Err("no golden answer has such a frame".into());
    }
    let observations = seen.iter().cycle().take(DECISIONS).map(OwnedObservation::view).collect();
    Ok(Scene { plan, arena, observations })
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

#[inline(never)]
// A scene is only lent: what it costs to give its memory back is no part of a decision.
fn counted_alone(scene: &mut Scene) {
    let Scene { plan, arena, observations } = scene;
    for observation in &*observations {
        let _ = black_box(plan.decide(arena.as_mut_slice(), observation, None));
    }
}

#[inline(never)]
fn counted_together(scene: &mut Scene) {
    let Scene { plan, arena, observations } = scene;
    let mut decisions: [Result<Decision, DecideError>; TEAM] = [Err(DecideError::BadLength); TEAM];
    for frame in observations.iter().take(DECISIONS / TEAM) {
        plan.decide_batch(arena.as_mut_slice(), &team(*frame), None, &mut decisions);
        let _ = black_box(&decisions);
    }
}
