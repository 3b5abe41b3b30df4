//! Heads that point: plans of random networks against plain loops.

use sortie_bundle::{OwnedObservation, Recording};
use sortie_core::EntityMask;
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_plans::random_observations;

use super::agent::bits;
use super::int8::ask;
use super::networks::{
    Random, Shape, ask_anything, int8_plan, int8_plan_for, plan, reference, run_forged,
};
use crate::matching::AgentLayers;

fn network(random: &mut Random, index: usize) -> (Shape, AgentLayers) {
    let shape = random.shape();
    let shape = Shape { actions: shape.actions + 1, ..shape };
    let layers = match index % 3 {
        0 => random.layers(shape),
        1 => {
            let layers = random.layers(shape);
            random.with_skip(layers)
        }
        _ => random.layers(Shape { last_action: true, ..shape }),
    };
    (shape, random.pointing(layers, shape))
}

fn observations(shape: Shape, count: usize, seed: u64) -> Vec<OwnedObservation> {
    random_observations(count, shape.n_max, shape.features, shape.actions, seed)
}

/// The largest distance of a plan's answers from the plain loops', relative to the largest utility.
fn distance(plan: &[u8], layers: &AgentLayers, seen: &[OwnedObservation]) -> f64 {
    let mut largest = 0.0_f64;
    for (observation, got) in seen.iter().zip(ask(plan, seen)) {
        let want = reference(layers, observation, &mut Vec::new());
        let most = want.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(&want) {
            largest = largest.max((f64::from(*got) - want).abs() / (1.0 + most));
        }
    }
    largest
}

#[test]
fn utilities_of_aimed_actions_are_products_with_embeddings() {
    let mut random = Random::new(71);
    for index in 0..60 {
        let (shape, layers) = network(&mut random, index);
        let seen = observations(shape, 12, index as u64);
        let distance = distance(&plan(&layers, shape), &layers, &seen);
        assert!(distance < 1e-5, "network {index}, {shape:?}: {distance}");
    }
}

#[test]
fn int8_is_near_whether_rounded_for_examples_or_not() {
    let mut random = Random::new(72);
    for index in 0..20 {
        let (shape, layers) = network(&mut random, index);
        let seen = observations(shape, 40, index as u64);
        let mut examples = Recording::new(0, shape.features, shape.actions);
        seen.iter().for_each(|seen| examples.add(&seen.view()));
        let plans = [int8_plan(&layers, shape), int8_plan_for(&layers, shape, Some(&examples))];
        for plan in plans {
            let distance = distance(&plan, &layers, &seen);
            assert!(distance > 1e-6 && distance < 0.05, "network {index}, {shape:?}: {distance}");
        }
    }
}

#[test]
fn every_build_and_a_team_give_the_same_bits() {
    let mut random = Random::new(73);
    for index in 0..20 {
        let (shape, layers) = network(&mut random, index);
        let plans = [plan(&layers, shape), int8_plan(&layers, shape)];
        for bytes in plans.iter().map(|plan| AlignedBytes::copy_of(plan)) {
            let plan = Plan::load(bytes.as_slice()).unwrap();
            let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(shape.n_max));
            for frame in observations(shape, 4, index as u64) {
                // Every agent of the frame looks at it, each at something else.
                let team: Vec<OwnedObservation> = (0..frame.entities())
                    .map(|own| {
                        let mut visible = frame.visible;
                        visible = visible.and(&EntityMask::first(own + 2));
                        OwnedObservation { self_index: own, visible, ..frame.clone() }
                    })
                    .collect();
                let views: Vec<_> = team
                    .iter()
                    .map(|seen| {
                        let (rows, last_actions) = (&*frame.rows, &*frame.last_actions);
                        sortie_core::Observation { rows, last_actions, ..seen.view() }
                    })
                    .collect();
                let mut together = vec![0.0; views.len() * shape.actions];
                let mut results = vec![Ok(()); views.len()];
                plan.utilities_batch(arena.as_mut_slice(), &views, &mut together, &mut results);
                for (view, together) in views.iter().zip(together.chunks(shape.actions)) {
                    for build in [Build::PORTABLE, Build::widest()] {
                        let mut alone = vec![0.0; shape.actions];
                        let plan = plan.clone().on(build);
                        plan.utilities(arena.as_mut_slice(), view, None, &mut alone).unwrap();
                        assert_eq!(bits(together), bits(&alone), "network {index}, {shape:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn forged_plans_never_panic_or_leave_their_arena() {
    let shape = super::agent::SMALL;
    let mut random = Random::new(74);
    let layers = random.layers(shape);
    let layers = random.pointing(layers, shape);
    let observation = &observations(shape, 1, 3)[0];
    for good in [plan(&layers, shape), int8_plan(&layers, shape)] {
        let (refused, ran) = run_forged(&good, |plan| ask_anything(plan, observation));
        assert!(refused > 200 && ran > 200, "{refused} refused, {ran} ran");
    }
}
