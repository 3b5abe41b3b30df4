//! Plans of random networks against plain loops, and the laws that every plan obeys.

use sortie_bundle::OwnedObservation;
use sortie_core::identity::fnv1a;
use sortie_core::internal::kernels::build::Build;
use sortie_core::internal::ops::Op;
use sortie_core::plan::{AlignedBytes, Plan, PlanError, ProgramDraft};
use sortie_core::{DecideError, EntityMask, NO_ACTION, PlanPolicy, Policy};

use super::networks::{Random, Shape, ask_anything, plan, reference, run_forged, with_program};
use crate::matching::Step;
use sortie_plans::random_observations;

pub(crate) const SMALL: Shape =
    Shape { n_max: 6, features: 5, actions: 4, last_action: true, width: 16, heads: 2, base: 8 };

/// A plan with its arena, for tests that ask it many questions.
struct Engine {
    bytes: AlignedBytes,
    arena: AlignedBytes,
}

impl Engine {
    fn new(plan: &[u8]) -> Self {
        let bytes = AlignedBytes::copy_of(plan);
        let arena = AlignedBytes::zeroed(Plan::load(bytes.as_slice()).unwrap().arena_bytes());
        Self { bytes, arena }
    }

    fn small() -> Self {
        Self::new(&plan(&Random::new(1).layers(SMALL), SMALL))
    }

    fn ask(&mut self, observation: &OwnedObservation) -> Result<Vec<f32>, DecideError> {
        let plan = Plan::load(self.bytes.as_slice()).unwrap();
        let mut utilities = vec![0.0; plan.actions()];
        // What stands in the arena before must not matter.
        self.arena.as_mut_slice().fill(0xff);
        let mut policy = PlanPolicy::new(plan, self.arena.as_mut_slice()).unwrap();
        policy.utilities(&observation.view(), &mut utilities).map(|()| utilities)
    }

    fn ask_portable(&mut self, observation: &OwnedObservation) -> Vec<f32> {
        let plan = Plan::load(self.bytes.as_slice()).unwrap().on(Build::PORTABLE);
        let mut utilities = vec![0.0; plan.actions()];
        let arena = self.arena.as_mut_slice();
        plan.utilities(arena, &observation.view(), None, &mut utilities).unwrap();
        utilities
    }
}

pub(crate) fn bits(utilities: &[f32]) -> Vec<u32> {
    utilities.iter().map(|utility| utility.to_bits()).collect()
}

pub(crate) fn small_observations(count: usize) -> Vec<OwnedObservation> {
    random_observations(count, SMALL.n_max, SMALL.features, SMALL.actions, 3)
}

#[test]
fn random_networks_agree_with_plain_loops() {
    let mut random = Random::new(42);
    for index in 0..60 {
        let shape = random.shape();
        let mut layers = random.layers(shape);
        if index % 2 == 0 {
            layers = random.with_skip(layers);
        }
        let mut engine = Engine::new(&plan(&layers, shape));
        let Shape { n_max, features, actions, .. } = shape;
        for observation in random_observations(12, n_max, features, actions, index) {
            let got = engine.ask(&observation).unwrap();
            for (got, want) in got.iter().zip(reference(&layers, &observation, &mut Vec::new())) {
                let error = (f64::from(*got) - want).abs() / (1.0 + want.abs());
                assert!(error < 1e-5, "network {index}, {shape:?}: {got}, want {want}");
            }
        }
    }
}

#[test]
fn every_build_of_the_kernels_gives_the_same_bits() {
    let mut random = Random::new(43);
    for index in 0..20 {
        let shape = random.shape();
        let mut engine = Engine::new(&plan(&random.layers(shape), shape));
        let Shape { n_max, features, actions, .. } = shape;
        for observation in random_observations(12, n_max, features, actions, index) {
            let chosen = bits(&engine.ask(&observation).unwrap());
            assert_eq!(chosen, bits(&engine.ask_portable(&observation)), "{shape:?}");
        }
    }
}

#[test]
fn the_bits_are_the_recorded_ones() {
    let mut engine = Engine::small();
    let all =
        small_observations(64).iter().flat_map(|o| engine.ask(o).unwrap()).collect::<Vec<_>>();
    let bytes: Vec<u8> = all.iter().flat_map(|utility| utility.to_le_bytes()).collect();
    assert_eq!(fnv1a(&bytes), RECORDED, "{:#x}", fnv1a(&bytes));
}

/// FNV-1a of the small network's utilities on 64 observations. It changes only with the arithmetic contract.
const RECORDED: u64 = 0xc7aa_1e69_9a0d_cd80;

#[test]
fn what_is_behind_the_mask_never_matters() {
    let mut engine = Engine::small();
    for observation in small_observations(100) {
        let want = bits(&engine.ask(&observation).unwrap());
        let mut poisoned = observation.clone();
        let rows = poisoned.rows.chunks_mut(poisoned.features).enumerate();
        for (entity, row) in rows {
            if !observation.visible.contains(entity) && entity != observation.self_index {
                row.fill(f32::NAN);
                if let Some(last) = poisoned.last_actions.get_mut(entity) {
                    *last = 999;
                }
            }
        }
        assert_eq!(want, bits(&engine.ask(&poisoned).unwrap()));
    }
}

#[test]
fn the_order_of_entities_does_not_matter() {
    let mut engine = Engine::small();
    for mut observation in small_observations(100) {
        let entities = observation.entities();
        observation.last_actions.resize(entities, NO_ACTION);
        let want = engine.ask(&observation).unwrap();
        let mut turned = observation.clone();
        turned.rows.rotate_left(observation.features);
        turned.last_actions.rotate_left(1);
        turned.self_index = (observation.self_index + entities - 1) % entities;
        turned.visible = EntityMask::EMPTY;
        for entity in observation.visible.iter() {
            turned.visible.insert((entity + entities - 1) % entities);
        }
        for (got, want) in engine.ask(&turned).unwrap().iter().zip(want) {
            assert!((got - want).abs() <= 1e-6 * (1.0 + want.abs()), "{got}, want {want}");
        }
    }
}

#[test]
fn an_own_row_that_is_masked_still_forms_the_query() {
    let mut engine = Engine::small();
    let mut observation = OwnedObservation {
        rows: (0..15).map(|index| (index % 7) as f32 / 7.0).collect(),
        features: 5,
        last_actions: vec![1],
        visible: EntityMask::from_words(&[0b110]),
        self_index: 0,
        available: vec![1; 4],
    };
    let before = engine.ask(&observation).unwrap();
    observation.rows[0] = 2.0;
    assert_ne!(before, engine.ask(&observation).unwrap(), "the query did not change");
}

#[test]
fn an_agent_that_sees_nothing_gets_what_its_biases_say() {
    let mut engine = Engine::small();
    let layers = Random::new(1).layers(SMALL);
    for mut observation in small_observations(20) {
        observation.visible = EntityMask::EMPTY;
        let got = engine.ask(&observation).unwrap();
        let relu = |sum: f32| if layers.output.relu { sum.max(0.0) } else { sum };
        let mut value: Vec<f32> = layers.output.bias.iter().map(|&bias| relu(bias)).collect();
        for step in &layers.steps {
            let Step::Dense(layer) = step else { panic!("{step:?}") };
            let mut sums = layer.bias.clone();
            for (input, row) in value.iter().zip(layer.matrix.values.chunks(layer.matrix.outputs)) {
                sums.iter_mut().zip(row).for_each(|(sum, weight)| *sum += input * weight);
            }
            let relu = |sum: f32| if layer.relu && sum < 0.0 { 0.0 } else { sum };
            value = sums.into_iter().map(relu).collect();
        }
        assert_eq!(bits(&got), bits(&value));
    }
}

#[test]
fn bad_observations_are_refused_by_name() {
    let mut engine = Engine::small();
    let good = OwnedObservation {
        rows: vec![0.5; 10],
        features: 5,
        last_actions: vec![0],
        visible: EntityMask::first(2),
        self_index: 0,
        available: vec![1; 4],
    };
    let mut with = |change: fn(&mut OwnedObservation)| {
        let mut observation = good.clone();
        change(&mut observation);
        engine.ask(&observation)
    };
    assert!(with(|_| {}).is_ok());
    assert_eq!(with(|o| o.rows[7] = f32::NAN), Err(DecideError::NonFinite));
    assert_eq!(with(|o| o.rows[0] = f32::INFINITY), Err(DecideError::NonFinite));
    assert_eq!(with(|o| o.rows[0] = 3.0e38), Err(DecideError::NonFinite));
    assert_eq!(with(|o| o.rows.truncate(9)), Err(DecideError::BadLength));
    assert_eq!(with(|o| o.self_index = 2), Err(DecideError::BadLength));
    assert_eq!(with(|o| o.self_index = usize::MAX), Err(DecideError::BadLength));
    assert_eq!(with(|o| o.last_actions[0] = 4), Err(DecideError::BadLength));
    let too_many = Err(DecideError::TooManyEntities { max: 6, got: 7 });
    assert_eq!(with(|o| o.visible = EntityMask::first(7)), too_many);
}

#[test]
fn a_decision_needs_an_available_action() {
    let engine = Engine::small();
    let plan = Plan::load(engine.bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    for mut observation in small_observations(50) {
        let decision = policy.decide(&observation.view()).unwrap();
        assert!(observation.available[usize::from(decision.action)] > 0);
        observation.available.fill(0);
        let refused = policy.decide(&observation.view());
        assert_eq!(refused, Err(DecideError::NoAvailableAction));
        observation.available.pop();
        assert_eq!(policy.decide(&observation.view()), Err(DecideError::BadLength));
    }
}

#[test]
fn a_plan_needs_an_arena_that_is_large_and_aligned() {
    let engine = Engine::small();
    let plan = Plan::load(engine.bytes.as_slice()).unwrap();
    let need = plan.arena_bytes();
    let mut arena = AlignedBytes::zeroed(need + 64);
    let mut refused = |range: std::ops::Range<usize>| {
        PlanPolicy::new(plan.clone(), &mut arena.as_mut_slice()[range]).map(|_| ()).unwrap_err()
    };
    assert_eq!(refused(0..need - 1), PlanError::ArenaTooSmall { need, got: need - 1 });
    assert_eq!(refused(4..need + 4), PlanError::Misaligned { need: 64, got: 4 });
}

#[test]
fn damaged_plans_are_refused_or_unchanged() {
    let good = Engine::small().bytes.as_slice().to_vec();
    let observation = &small_observations(1)[0];
    let want = bits(&Engine::small().ask(observation).unwrap());
    let mut bytes = AlignedBytes::copy_of(&good);
    for at in 0..good.len() {
        let value = bytes.as_slice()[at];
        bytes.as_mut_slice()[at] = !value;
        if Plan::load(bytes.as_slice()).is_ok() {
            assert_eq!(bits(&Engine::new(bytes.as_slice()).ask(observation).unwrap()), want);
        }
        bytes.as_mut_slice()[at] = value;
    }
    for len in 0..good.len() {
        assert!(Plan::load(&bytes.as_slice()[..len]).is_err(), "cut at {len}");
    }
    assert_eq!(Plan::load(&[]).map(|_| ()), Err(PlanError::Truncated { need: 128, got: 0 }));
}

#[test]
fn forged_plans_never_panic_or_leave_their_arena() {
    let observation = &small_observations(1)[0];
    let (refused, ran) =
        run_forged(Engine::small().bytes.as_slice(), |plan| ask_anything(plan, observation));
    assert!(refused > 200 && ran > 200, "{refused} refused, {ran} ran");
}

#[test]
fn a_program_without_its_ends_is_refused() {
    let good = Engine::small().bytes.as_slice().to_vec();
    let plan = AlignedBytes::copy_of(&good);
    let program = ProgramDraft::of(Plan::load(plan.as_slice()).unwrap().program());
    assert!(matches!(program.ops.first(), Some(Op::EmbedEntities(_))));
    let shortened = |skip: usize, take: usize| {
        let mut program = program.clone();
        program.ops = program.ops.iter().skip(skip).take(take).copied().collect();
        let forged = with_program(&good, &program);
        Plan::load(forged.as_slice()).map(|_| ()).unwrap_err()
    };
    assert_eq!(shortened(1, 16), PlanError::ShapeMismatch { op: 0 });
    assert!(matches!(shortened(0, 4), PlanError::ShapeMismatch { .. }));
    assert!(matches!(shortened(0, 0), PlanError::ShapeMismatch { .. }));
}
