//! Laws of a decision, on the golden observations of every shipped bundle, in every arithmetic profile.

use std::path::PathBuf;

use sortie_bundle::{Bundle, OwnedObservation};
use sortie_compiler::InProcess;
use sortie_core::choose::masked_argmax;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, Profile};
use sortie_core::{DecideError, EntityMask, NO_ACTION};
use sortie_plans::BundlePlans;

const PROFILES: [Profile; 3] = [Profile::Exact, Profile::Fused, Profile::Int8];

fn plans() -> BundlePlans<InProcess> {
    BundlePlans::new(InProcess, None, |note| panic!("{note}"))
}

/// A shipped network in one profile.
struct Network {
    profile: Profile,
    plan: AlignedBytes,
    arena: AlignedBytes,
}

impl Network {
    /// `None` where this machine does not have the profile.
    fn open(bundle: &Bundle, profile: Profile) -> Option<Self> {
        let plan = plans().agent(bundle, profile).unwrap();
        let arena = match Plan::load(plan.as_slice()) {
            Ok(plan) => AlignedBytes::zeroed(plan.batch_arena_bytes(16)),
            Err(PlanError::WrongProfile { .. }) => return None,
            Err(error) => panic!("{error}"),
        };
        Some(Self { profile, plan, arena })
    }

    fn utilities(&mut self, observation: &OwnedObservation) -> Vec<f32> {
        let plan = Plan::load(self.plan.as_slice()).unwrap();
        let mut utilities = vec![0.0; plan.actions()];
        let arena = self.arena.as_mut_slice();
        plan.utilities(arena, &observation.view(), None, &mut utilities).unwrap();
        utilities
    }
}

/// Runs a law for every shipped bundle and every profile; the exact one is everywhere.
fn everywhere(mut law: impl FnMut(&mut Network, &[OwnedObservation])) {
    let models = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let mut networks = 0;
    for folder in models.read_dir().unwrap() {
        let bundle = Bundle::open(&folder.unwrap().path()).unwrap();
        let golden = bundle.golden().cases.iter().map(|case| case.observation.clone());
        let golden: Vec<_> = golden.collect();
        for mut network in
            PROFILES.into_iter().filter_map(|profile| Network::open(&bundle, profile))
        {
            law(&mut network, &golden);
            networks += 1;
        }
    }
    assert!(networks >= 3, "{networks} networks");
}

fn bits(utilities: &[f32]) -> Vec<u32> {
    utilities.iter().map(|utility| utility.to_bits()).collect()
}

#[test]
fn what_is_behind_the_mask_never_changes_a_bit() {
    everywhere(|network, golden| {
        for observation in golden {
            let mut poisoned = observation.clone();
            for (entity, row) in poisoned.rows.chunks_mut(observation.features).enumerate() {
                if !observation.visible.contains(entity) && entity != observation.self_index {
                    row.fill(f32::NAN);
                }
            }
            let [want, got] = [observation, &poisoned].map(|seen| bits(&network.utilities(seen)));
            assert_eq!(got, want);
        }
    });
}

#[test]
fn the_order_of_entities_changes_rounding_only() {
    everywhere(|network, golden| {
        for observation in golden {
            let want = network.utilities(observation);
            for by in 1..observation.entities() {
                let got = network.utilities(&turned(observation, by));
                // What is rounded to integers can fall to the other side.
                let unit = if network.profile == Profile::Int8 { 1e-3 } else { 1e-6 };
                let band = |utility: f32| unit * (1.0 + utility.abs());
                for (got, want) in got.iter().zip(&want) {
                    assert!((got - want).abs() <= band(*want), "{got}, want {want}");
                }
                let [got, best] = [&got, &want]
                    .map(|utilities| masked_argmax(utilities, &observation.available).unwrap());
                let as_good = want[usize::from(got.action)];
                assert!(
                    got.action == best.action || best.utility - as_good <= 2.0 * band(best.utility),
                    "another action outside the band"
                );
            }
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
    everywhere(|network, golden| {
        for frame in golden {
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
            let plan = Plan::load(network.plan.as_slice()).unwrap();
            let mut together = vec![0.0; agents * plan.actions()];
            let mut results = vec![Err(DecideError::BadLength); agents];
            let arena = network.arena.as_mut_slice();
            plan.utilities_batch(arena, &seen, &mut together, &mut results);
            assert!(results.iter().all(Result::is_ok), "{results:?}");
            for (member, got) in team.iter().zip(together.chunks(plan.actions())) {
                assert_eq!(bits(got), bits(&network.utilities(member)));
            }
        }
    });
}
