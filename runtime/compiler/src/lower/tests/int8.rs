//! int8 plans of random networks against plain loops, and the laws that they obey.

use sortie_bundle::OwnedObservation;
use sortie_core::internal::ops::Op;
use sortie_core::plan::{AlignedBytes, Plan, ProgramDraft};
use sortie_core::{EntityMask, PlanPolicy, Policy};

use super::agent::{SMALL, bits, small_observations};
use super::networks::{Random, ask_anything, int8_plan, reference, run_forged, with_program};
use crate::lower::{AgentSizes, Choice, lower_agent_int8};
use sortie_plans::CompileError;
use sortie_plans::random_observations;

pub(super) fn ask(plan: &[u8], observations: &[OwnedObservation]) -> Vec<Vec<f32>> {
    let bytes = AlignedBytes::copy_of(plan);
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let mut ask = |observation: &OwnedObservation| {
        let mut utilities = vec![0.0; policy.actions()];
        policy.utilities(&observation.view(), &mut utilities).unwrap();
        utilities
    };
    observations.iter().map(&mut ask).collect()
}

#[test]
fn random_networks_are_near_plain_loops() {
    let mut random = Random::new(21);
    let mut largest = 0.0_f64;
    for index in 0..40 {
        let shape = random.shape();
        let mut layers = random.layers(shape);
        if index % 2 == 0 {
            layers = random.with_skip(layers);
        }
        let observations = random_observations(
            8,
            shape.n_max,
            shape.features,
            shape.actions,
            random.below(1000) as u64,
        );
        let answers = ask(&int8_plan(&layers, shape), &observations);
        for (observation, got) in observations.iter().zip(answers) {
            let want = reference(&layers, observation, &mut Vec::new());
            let most = want.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            for (got, want) in got.iter().zip(&want) {
                largest = largest.max((f64::from(*got) - want).abs() / (1.0 + most));
            }
        }
    }
    // Weights are within half of a 127th of the largest of their output: a small error, and not none.
    assert!(largest > 1e-5 && largest < 0.02, "{largest}");
}

#[test]
fn rows_behind_the_mask_change_no_bit() {
    let plan = int8_plan(&Random::new(1).layers(SMALL), SMALL);
    let mut observations = small_observations(64);
    let want = ask(&plan, &observations);
    for observation in &mut observations {
        let mut seen = observation.visible;
        seen.insert(observation.self_index);
        for entity in (0..observation.entities()).filter(|entity| !seen.contains(*entity)) {
            observation.rows[entity * SMALL.features..][..SMALL.features].fill(f32::NAN);
        }
    }
    for (want, got) in want.iter().zip(ask(&plan, &observations)) {
        assert_eq!(bits(want), bits(&got));
    }
}

#[test]
fn an_agent_that_sees_nothing_still_answers() {
    let layers = Random::new(1).layers(SMALL);
    let mut observations = small_observations(4);
    observations.iter_mut().for_each(|seen| seen.visible = EntityMask::EMPTY);
    let answers = ask(&int8_plan(&layers, SMALL), &observations);
    assert!(answers.iter().all(|answer| bits(answer) == bits(&answers[0])));
    let want = reference(&layers, &observations[0], &mut Vec::new());
    for (got, want) in answers[0].iter().zip(want) {
        assert!((f64::from(*got) - want).abs() < 0.02, "{got}, want {want}");
    }
}

#[test]
fn recurrent_units_are_refused_by_name() {
    let layers = Random::new(1).recurrent_layers(SMALL, 8);
    let sizes = AgentSizes {
        n_max: SMALL.n_max,
        features: SMALL.features,
        actions: SMALL.actions,
        choice: Choice::Greedy,
    };
    let refused = lower_agent_int8(&layers, sizes, None).unwrap_err();
    assert!(matches!(refused, CompileError::NoInt8 { .. }) && refused.to_string().contains("Gru"));
}

#[test]
fn forged_plans_are_refused_or_stay_inside_their_arena() {
    let plan = int8_plan(&Random::new(1).layers(SMALL), SMALL);
    let observation = &small_observations(1)[0];
    let (refused, ran) = run_forged(&plan, |plan| ask_anything(plan, observation));
    assert!(refused > 500 && ran > 50, "{refused} refused, {ran} ran");
}

#[test]
fn layers_that_read_what_they_write_are_refused() {
    let plan = int8_plan(&Random::new(1).layers(SMALL), SMALL);
    let loaded = AlignedBytes::copy_of(&plan);
    let mut program = ProgramDraft::of(Plan::load(loaded.as_slice()).unwrap().program());
    for op in &mut program.ops {
        if let Op::Int8Dense(op) = op {
            op.to = op.from;
        }
    }
    assert!(Plan::load(with_program(&plan, &program).as_slice()).is_err());
}
