//! Plans that remember, and plans that draw: against plain loops, and what they refuse.

use sortie_core::choose::masked_sample;
use sortie_core::identity::fnv1a;
use sortie_core::internal::kernels::build::Build;
use sortie_core::operators::FeedForward;
use sortie_core::plan::{AlignedBytes, Plan, PlanError};
use sortie_core::{DecideError, Decision, EntityMask, PlanPolicy, Policy};

use super::agent::{SMALL, bits, small_observations};
use super::networks::{Random, Shape, ask_anything, forge, plan, plan_that, reference, run_forged};
use crate::lower::Choice;
use sortie_plans::random_observations;

/// Floats of the small network's state.
const STATE: usize = 5;

fn small() -> AlignedBytes {
    AlignedBytes::copy_of(&plan(&Random::new(1).recurrent_layers(SMALL, STATE), SMALL))
}

/// An arena for a plan, not clean.
fn arena(plan: &Plan<'_>) -> AlignedBytes {
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    arena.as_mut_slice().fill(0xff);
    arena
}

#[test]
fn random_agents_agree_with_plain_loops_over_episodes() {
    let mut random = Random::new(44);
    for index in 0..30 {
        let shape = random.shape();
        let size = 1 + random.below(80);
        let mut layers = random.recurrent_layers(shape, size);
        if index % 2 == 0 {
            layers = random.with_skip(layers);
        }
        let bytes = AlignedBytes::copy_of(&plan(&layers, shape));
        let plan = Plan::load(bytes.as_slice()).unwrap();
        assert_eq!(plan.hidden(), size);
        let mut arena = arena(&plan);
        let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
        let Shape { n_max, features, actions, .. } = shape;
        let (mut state, mut wanted_state) = (vec![0.0; size], vec![0.0; size]);
        for observation in random_observations(12, n_max, features, actions, index) {
            let mut got = vec![0.0; actions];
            policy.utilities_with(&observation.view(), &mut state, &mut got).unwrap();
            let want = reference(&layers, &observation, &mut wanted_state);
            let pairs = got.iter().zip(&want).chain(state.iter().zip(&wanted_state));
            for (got, want) in pairs {
                let error = (f64::from(*got) - want).abs() / (1.0 + want.abs());
                assert!(error < 1e-5, "network {index}, {shape:?}: {got}, want {want}");
            }
        }
    }
}

#[test]
fn every_build_remembers_the_same_bits_and_they_are_the_recorded_ones() {
    let bytes = small();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let portable = plan.clone().on(Build::PORTABLE);
    let mut arena = arena(&plan);
    let (mut state, mut portable_state) = ([0.0; STATE], [0.0; STATE]);
    let mut recorded = Vec::new();
    for observation in small_observations(64) {
        let view = observation.view();
        let (mut utilities, mut others) = ([0.0; 4], [0.0; 4]);
        plan.utilities(arena.as_mut_slice(), &view, Some(&mut state), &mut utilities).unwrap();
        let other = Some(portable_state.as_mut_slice());
        portable.utilities(arena.as_mut_slice(), &view, other, &mut others).unwrap();
        assert_eq!(bits(&utilities), bits(&others));
        assert_eq!(bits(&state), bits(&portable_state));
        recorded.extend(utilities.iter().chain(&state).flat_map(|value| value.to_le_bytes()));
    }
    assert_eq!(fnv1a(&recorded), RECORDED, "{:#x}", fnv1a(&recorded));
}

/// FNV-1a of utilities and states of 64 steps. It changes only with the arithmetic contract.
const RECORDED: u64 = 0x2397_69be_8556_5150;

/// Decisions of `agents`, each alone and then all in one call of the same plan, over an episode; in every second step one
/// of them sees or remembers what is no number, in every third nobody is seen.
fn decide_both_ways(shape: Shape, size: usize, room: usize, agents: usize) {
    let mut random = Random::new(size as u64);
    let bytes = AlignedBytes::copy_of(&plan(&random.recurrent_layers(shape, size), shape));
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(room));
    let (mut apart, mut together) = (vec![0.0; agents * size], vec![0.0; agents * size]);
    let frames = random_observations(12, shape.n_max, shape.features, shape.actions, 5);
    for (step, mut frame) in frames.into_iter().enumerate() {
        let (broken_row, broken_state) = (step % 4 == 1, step % 4 == 3);
        if broken_row {
            frame.rows[0] = f32::NAN;
        }
        for states in [&mut apart, &mut together] {
            // The gates overflow, and saturate.
            states[..size].fill(if broken_state { f32::MAX } else { 0.5 });
        }
        let observe = |agent| {
            let mut observation = frame.view();
            observation.self_index = agent;
            (step % 3 == 2).then(|| observation.visible = EntityMask::EMPTY);
            observation.visible.remove(agent);
            observation
        };
        let observations: Vec<_> = (0..agents).map(observe).collect();
        let states = apart.chunks_exact_mut(size);
        let alone: Vec<_> = observations
            .iter()
            .zip(states)
            .map(|(seen, state)| plan.decide(arena.as_mut_slice(), seen, Some(state)))
            .collect();
        let mut decisions = vec![Err(DecideError::BadLength); agents];
        let states = Some(together.as_mut_slice());
        plan.decide_batch(arena.as_mut_slice(), &observations, states, &mut decisions);
        assert_eq!(decisions, alone, "{size}, room for {room}, step {step}");
        assert_eq!(bits(&together), bits(&apart), "{size}, room for {room}, step {step}");
        let broken = broken_row || (broken_state && size > 1);
        assert_eq!(alone.contains(&Err(DecideError::NonFinite)), broken);
    }
    assert!(together.chunks_exact(size).skip(1).all(|state| state != &together[..size]));
}

#[test]
fn agents_that_remember_decide_together_as_they_would_alone() {
    let shape = Shape { n_max: 6, ..SMALL };
    for size in [1, 5, 16, 40] {
        for room in [1, 2, 6] {
            decide_both_ways(shape, size, room, 6);
        }
    }
}

#[test]
fn a_state_of_another_size_is_refused_and_none_is_touched() {
    let bytes = small();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = arena(&plan);
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let observation = &small_observations(1)[0];
    let refused = |got| Err(DecideError::HiddenState { want: STATE, got });
    assert_eq!(policy.decide(&observation.view()), refused(0));
    assert_eq!(policy.decide_with(&observation.view(), &mut [0.0; 4]), refused(4));
    for bad in [f32::NAN, f32::INFINITY] {
        let mut state = [0.25, bad, 0.0, 0.0, 0.5];
        let before = bits(&state);
        let decision = policy.decide_with(&observation.view(), &mut state);
        assert_eq!(decision, Err(DecideError::NonFinite));
        assert_eq!(bits(&state), before);
    }
    let mut decisions = [Ok(Decision { action: 0, utility: 0.0 }); 3];
    policy.decide_batch(&[observation.view(); 3], &mut decisions);
    let refused_all = |got| [Err(DecideError::HiddenState { want: 3 * STATE, got }); 3];
    assert_eq!(decisions, refused_all(0));
    policy.decide_batch_with(&[observation.view(); 3], &mut [0.0; 4], &mut decisions);
    assert_eq!(decisions, refused_all(4));
    let forgetful = AlignedBytes::copy_of(&self::plan(&Random::new(1).layers(SMALL), SMALL));
    let plan = Plan::load(forgetful.as_slice()).unwrap();
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let decision = policy.decide_with(&observation.view(), &mut [0.0; STATE]);
    assert_eq!(decision, Err(DecideError::HiddenState { want: 0, got: STATE }));
    assert!(policy.decide_with(&observation.view(), &mut []).is_ok());
}

#[test]
fn a_set_of_operators_runs_what_it_has_and_refuses_the_rest() {
    let (recurrent, layers) = (small(), Random::new(1).layers(SMALL));
    let refused = Plan::<FeedForward>::load_with(recurrent.as_slice()).map(|_| ());
    assert_eq!(refused, Err(PlanError::UnknownOp));
    let drawing = AlignedBytes::copy_of(&plan_that(Choice::Drawn, &layers, SMALL));
    let refused = Plan::<FeedForward>::load_with(drawing.as_slice()).map(|_| ());
    assert_eq!(refused, Err(PlanError::UnknownOp));
    let bytes = AlignedBytes::copy_of(&plan(&layers, SMALL));
    let few = Plan::<FeedForward>::load_with(bytes.as_slice()).unwrap();
    let all = Plan::load(bytes.as_slice()).unwrap();
    let (mut few_arena, mut all_arena) = (arena(&all), arena(&all));
    let mut few = PlanPolicy::new(few, few_arena.as_mut_slice()).unwrap();
    let mut all = PlanPolicy::new(all, all_arena.as_mut_slice()).unwrap();
    for observation in small_observations(20) {
        assert_eq!(few.decide(&observation.view()), all.decide(&observation.view()));
    }
}

#[test]
fn a_drawn_action_follows_from_the_logits_and_the_given_bits() {
    let layers = Random::new(1).layers(SMALL);
    let drawing = AlignedBytes::copy_of(&plan_that(Choice::Drawn, &layers, SMALL));
    let greedy = AlignedBytes::copy_of(&plan(&layers, SMALL));
    let drawing = Plan::load(drawing.as_slice()).unwrap();
    let greedy = Plan::load(greedy.as_slice()).unwrap();
    let mut arena = arena(&drawing);
    let arena = arena.as_mut_slice();
    let mut drawn = [0; 4];
    for (index, observation) in small_observations(200).iter().enumerate() {
        let (view, random) = (observation.view(), (index as u32).wrapping_mul(0x9e37_79b9));
        let mut logits = [0.0; 4];
        drawing.utilities(arena, &view, None, &mut logits).unwrap();
        let want = masked_sample(&logits, view.available, random);
        let got = drawing.sample(arena, &view, None, random);
        assert_eq!(got, want);
        drawn[usize::from(got.unwrap().action)] += 1;
        assert_eq!(drawing.decide(arena, &view, None), greedy.decide(arena, &view, None));
        assert_eq!(greedy.sample(arena, &view, None, random), Err(DecideError::Greedy));
    }
    assert!(drawn.iter().all(|count| *count > 10), "{drawn:?}");
}

#[test]
fn forged_units_never_panic_or_leave_their_arena() {
    let observation = &small_observations(1)[0];
    let (refused, ran) = run_forged(small().as_slice(), |plan| ask_anything(plan, observation));
    assert!(refused > 200 && ran > 200, "{refused} refused, {ran} ran");
}

#[test]
fn a_state_that_nobody_declared_is_refused() {
    let bytes = small();
    let forged = forge(bytes.as_slice(), |plan| plan[40] = STATE as u8 + 1);
    let refused = Plan::load(forged.unwrap().as_slice()).map(|_| ());
    assert!(matches!(refused, Err(PlanError::ShapeMismatch { .. })), "{refused:?}");
}
