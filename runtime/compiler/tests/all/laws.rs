//! Laws of a decision, on the golden observations of every shipped bundle whose agents attend to entities, in every arithmetic profile. What ships has a
//! skip; a network without one sees what the team for SaveTheCity saw.

use std::path::PathBuf;
use std::sync::LazyLock;

use sortie_bundle::{Bundle, OwnedObservation, POLICY};
use sortie_compiler::{InProcess, compile};
use sortie_core::choose::masked_argmax;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile};
use sortie_core::{DecideError, EntityMask, NO_ACTION};
use sortie_plans::{BundlePlans, CompileOptions};

const PROFILES: [Profile; 3] = [Profile::Exact, Profile::Fused, Profile::Int8];

fn plans() -> BundlePlans<InProcess> {
    BundlePlans::new(InProcess, None, |note| panic!("{note}"))
}

/// The plan of a network without a skip, with the features of SaveTheCity.
fn without_skip(n_max: usize, profile: Profile) -> AlignedBytes {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    let onnx = std::fs::read(format!("{root}agent_ff_default.onnx")).unwrap();
    let options = CompileOptions { n_max, profile, ..CompileOptions::default() };
    AlignedBytes::copy_of(&compile(&onnx, &options).unwrap().bytes)
}

/// A network in one profile, and what it is asked.
struct Network {
    profile: Profile,
    plan: AlignedBytes,
    golden: Vec<OwnedObservation>,
    /// Whether actions aim at entities by their numbers.
    points: bool,
}

impl Network {
    /// `None` where this machine does not have the profile.
    fn open(
        plan: AlignedBytes,
        profile: Profile,
        (golden, points): (&[OwnedObservation], bool),
    ) -> Option<Self> {
        match Plan::load(plan.as_slice()) {
            Ok(_) => Some(Self { profile, plan, golden: golden.to_vec(), points }),
            Err(PlanError::WrongProfile { .. }) => None,
            Err(error) => panic!("{error}"),
        }
    }

    fn plan(&self) -> Plan<'_> {
        Plan::load(self.plan.as_slice()).unwrap()
    }

    fn utilities(&self, arena: &mut AlignedBytes, observation: &OwnedObservation) -> Vec<f32> {
        let plan = self.plan();
        let mut utilities = vec![0.0; plan.actions()];
        plan.utilities(arena.as_mut_slice(), &observation.view(), None, &mut utilities).unwrap();
        utilities
    }
}

/// Every shipped bundle and a network without a skip, in every profile; the exact one is everywhere. Compiling is what takes
/// long, so it is done once.
static NETWORKS: LazyLock<Vec<Network>> = LazyLock::new(|| {
    let models = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let mut networks = Vec::new();
    for folder in models.read_dir().unwrap() {
        let folder = folder.unwrap().path();
        let bundle = Bundle::open(&folder).unwrap();
        if bundle.manifest().network.agent == POLICY || bundle.options().is_some() {
            continue;
        }
        let golden = bundle.golden().cases.iter().map(|case| case.observation.clone());
        let golden: Vec<_> = golden.collect();
        let most = golden.iter().map(OwnedObservation::entities).max().unwrap();
        let aims = b"sortie.targets";
        let points = bundle.agent_onnx().windows(aims.len()).any(|bytes| bytes == aims);
        for profile in PROFILES {
            let shipped = plans().agents(&bundle, profile).unwrap();
            let shipped = shipped.into_plans().pop();
            let plain = folder.ends_with("save-the-city").then(|| without_skip(most, profile));
            let plans = [shipped, plain].into_iter().flatten();
            networks
                .extend(plans.filter_map(|plan| Network::open(plan, profile, (&golden, points))));
        }
    }
    assert!(networks.len() >= 5, "{} networks", networks.len());
    networks
});

/// Runs a law for every network.
fn everywhere(law: impl Fn(&Network, &mut AlignedBytes)) {
    for network in &*NETWORKS {
        law(network, &mut AlignedBytes::zeroed(network.plan().batch_arena_bytes(16)));
    }
}

fn bits(utilities: &[f32]) -> Vec<u32> {
    utilities.iter().map(|utility| utility.to_bits()).collect()
}

#[test]
fn what_is_behind_the_mask_never_changes_a_bit() {
    everywhere(|network, arena| {
        for observation in &network.golden {
            let mut poisoned = observation.clone();
            for (entity, row) in poisoned.rows.chunks_mut(observation.features).enumerate() {
                if !observation.visible.contains(entity) && entity != observation.self_index {
                    row.fill(f32::NAN);
                }
            }
            let [want, got] =
                [observation, &poisoned].map(|seen| bits(&network.utilities(arena, seen)));
            assert_eq!(got, want);
        }
    });
}

#[test]
fn the_order_of_entities_changes_rounding_only() {
    everywhere(|network, arena| {
        // Who is aimed at goes by its number.
        let cases = if network.points { &[][..] } else { &network.golden };
        for (case, observation) in cases.iter().enumerate() {
            let want = network.utilities(arena, observation);
            // Each is turned once; all of them together by every number of places.
            let by = 1 + case % (observation.entities() - 1).max(1);
            let got = network.utilities(arena, &turned(observation, by));
            // What is rounded to integers can fall to the other side.
            let unit = if network.profile == Profile::Int8 { 1e-3 } else { 1e-6 };
            // A small utility may be the difference of large sums.
            let largest = want.iter().fold(0.0_f32, |most, utility| most.max(utility.abs()));
            let band = unit * (1.0 + largest);
            for (got, want) in got.iter().zip(&want) {
                assert!((got - want).abs() <= band, "{got}, want {want}, at most {band} apart");
            }
            let [got, best] = [&got, &want]
                .map(|utilities| masked_argmax(utilities, &observation.available).unwrap());
            let as_good = want[usize::from(got.action)];
            assert!(
                got.action == best.action || best.utility - as_good <= 2.0 * band,
                "another action outside the band"
            );
        }
    });
}

/// The same scene with the entities in another order.
fn turned(observation: &OwnedObservation, by: usize) -> OwnedObservation {
    let entities = observation.entities();
    let place = |entity: usize| (entity + entities - by) % entities;
    let mut turned = observation.clone();
    turned.rows.rotate_left(by * observation.features);
    turned.last_actions.resize(entities, NO_ACTION);
    turned.last_actions.rotate_left(by);
    turned.self_index = place(observation.self_index);
    turned.visible = EntityMask::EMPTY;
    observation.visible.iter().for_each(|entity| turned.visible.insert(place(entity)));
    turned
}

#[test]
fn a_team_gets_the_bits_that_its_members_get_alone() {
    everywhere(|network, arena| {
        for frame in network.golden.iter().step_by(4) {
            let agents = frame.last_actions.len();
            let team: Vec<_> = (0..agents)
                .map(|self_index| OwnedObservation { self_index, ..frame.clone() })
                .collect();
            // One frame: all members look at the same memory.
            let seen: Vec<_> = team
                .iter()
                .map(|member| sortie_core::Observation {
                    self_index: member.self_index,
                    ..frame.view()
                })
                .collect();
            let plan = network.plan();
            let mut together = vec![0.0; agents * plan.actions()];
            let mut results = vec![Err(DecideError::BadLength); agents];
            plan.utilities_batch(arena.as_mut_slice(), &seen, &mut together, &mut results);
            assert!(results.iter().all(Result::is_ok), "{results:?}");
            for (member, got) in team.iter().zip(together.chunks(plan.actions())) {
                assert_eq!(bits(got), bits(&network.utilities(arena, member)));
            }
        }
    });
}
