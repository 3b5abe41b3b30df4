//! Networks over all entities: attention of every query, means, sums by group, several outputs.

use sortie_core::internal::kernels::build::Build;
use sortie_core::internal::ops::{Members, OutputRows};
use sortie_core::plan::{AlignedBytes, Network, Plan, PlanError, Profile, ProgramDraft, Proof};
use sortie_core::{DecideError, Entities, EntityMask, PlanPolicy};

use super::agent::bits;
use super::networks::{Random, apply, attend, run_forged};
use crate::lower::{AgentSizes, Choice, EntitySizes, Origin, assemble, lower_entities};
use crate::matching::{AllAttention, EntityLayers, EntityStep, Layer};

/// A critic that also gives the embedding after attention, and the sums of embeddings by group.
struct Critic {
    shape: Shape,
    embed: Layer,
    query: Layer,
    key: Layer,
    value: Layer,
    output: Layer,
    head: Layer,
}

#[derive(Clone, Copy, Debug)]
struct Shape {
    n_max: usize,
    features: usize,
    width: usize,
    heads: usize,
    groups: usize,
    outputs: usize,
}

impl Critic {
    fn random(random: &mut Random) -> Self {
        let heads = 1 + random.below(5);
        let width = heads * (1 + random.below(12));
        let shape = Shape {
            n_max: 1 + random.below(20),
            features: 1 + random.below(30),
            width,
            heads,
            groups: 1 + random.below(7),
            outputs: 1 + random.below(3),
        };
        let mut layer = |inputs, outputs, relu| random.layer(inputs, outputs, relu);
        Self {
            shape,
            embed: layer(shape.features, width, true),
            query: layer(width, width, false),
            key: layer(width, width, false),
            value: layer(width, width, false),
            output: layer(width, width, true),
            head: layer(width, shape.outputs, false),
        }
    }

    fn plan(&self) -> AlignedBytes {
        let Shape { n_max, features, heads, groups, outputs, .. } = self.shape;
        let [query, key, value, output] =
            [&self.query, &self.key, &self.value, &self.output].map(Layer::clone);
        let attention = Box::new(AllAttention { heads, query, key, value, output });
        let layers = EntityLayers {
            embed: self.embed.clone(),
            steps: vec![
                EntityStep::Attend { rows: 0, attention },
                EntityStep::Mean { rows: 1, members: Members::Agents },
                EntityStep::Dense { from: 2, layer: self.head.clone() },
                EntityStep::GroupSum { rows: 0 },
            ],
            outputs: vec![3, 1, 4],
        };
        let of_entities = EntitySizes { n_max, features, groups };
        let (program, weights) = lower_entities(&layers, of_entities).unwrap();
        let sizes = AgentSizes { n_max, features, actions: outputs, choice: Choice::Greedy };
        let origin = Origin {
            source: [0; 32],
            profile: Profile::Exact,
            network: Network::Entities,
            contract: 0,
            t_max: groups as u16,
            proof: Proof::NONE,
            action_mismatch: 0.0,
        };
        AlignedBytes::copy_of(&assemble(&program, &weights.to_bytes(), sizes, &origin).unwrap())
    }

    /// The three outputs by the book.
    fn reference(&self, scene: &Scene) -> [Vec<f64>; 3] {
        let Shape { features, width, heads, groups, .. } = self.shape;
        let present: Vec<usize> = scene.present.iter().collect();
        let row = |entity: &usize| -> Vec<f64> {
            let row = &scene.rows[entity * features..][..features];
            apply(&self.embed, &row.iter().map(|&value| value.into()).collect::<Vec<_>>())
        };
        let embedded: Vec<Vec<f64>> = present.iter().map(row).collect();
        let of = |layer: &Layer| embedded.iter().map(|row| apply(layer, row)).collect::<Vec<_>>();
        let (queries, keys, values) = (of(&self.query), of(&self.key), of(&self.value));
        let mut entities = vec![0.0; scene.groups.len() * width];
        let mut sums = vec![0.0; groups * width];
        let mut mean = vec![0.0; width];
        for (slot, &entity) in present.iter().enumerate() {
            // The plan's scale of 1 / √h is folded into the query.
            let attended = attend(&queries[slot], &keys, &values, heads);
            let attended = apply(&self.output, &attended);
            entities[entity * width..][..width].copy_from_slice(&attended);
            if scene.agents.contains(entity) {
                mean.iter_mut().zip(&attended).for_each(|(sum, value)| *sum += value);
            }
            for group in (0..groups).filter(|group| scene.groups[entity] >> group & 1 == 1) {
                let sums = sums[group * width..][..width].iter_mut();
                sums.zip(&embedded[slot]).for_each(|(sum, value)| *sum += value);
            }
        }
        let agents = scene.agents.len().max(1) as f64;
        mean.iter_mut().for_each(|sum| *sum /= agents);
        [apply(&self.head, &mean), entities, sums]
    }

    /// What the plan answers.
    fn ask(&self, plan: &Plan<'_>, scene: &Scene) -> Result<[Vec<f32>; 3], DecideError> {
        let Shape { width, groups, outputs, .. } = self.shape;
        let lengths = [outputs, scene.groups.len() * width, groups * width];
        let mut answers = lengths.map(|len| vec![f32::NAN; len]);
        let [a, b, c] = &mut answers;
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        arena.as_mut_slice().fill(0xff);
        plan.evaluate(arena.as_mut_slice(), &scene.view(self.shape.features), &mut [a, b, c])?;
        Ok(answers)
    }
}

/// All entities of one step.
#[derive(Clone, Debug)]
struct Scene {
    rows: Vec<f32>,
    present: EntityMask,
    agents: EntityMask,
    groups: Vec<u32>,
}

impl Scene {
    fn random(random: &mut Random, shape: Shape) -> Self {
        let entities = 1 + random.below(shape.n_max);
        let rows = (0..entities * shape.features).map(|_| random.uniform(1.0)).collect();
        let mut mask = |chance: usize| {
            let mut mask = EntityMask::EMPTY;
            let drawn = (0..entities).filter(|_| random.below(4) < chance);
            drawn.for_each(|entity| mask.insert(entity));
            mask
        };
        let (present, agents) = (mask(3), mask(2));
        let groups = (0..entities).map(|_| random.below(1 << shape.groups) as u32).collect();
        Self { rows, present, agents, groups }
    }

    fn view(&self, stride: usize) -> Entities<'_> {
        let Self { rows, present, agents, groups } = self;
        Entities { rows, stride, present: *present, agents: *agents, groups }
    }
}

#[test]
fn every_output_agrees_with_plain_loops_in_every_build() {
    let mut random = Random::new(45);
    for index in 0..30 {
        let critic = Critic::random(&mut random);
        let bytes = critic.plan();
        let plan = Plan::load(bytes.as_slice()).unwrap();
        for _ in 0..10 {
            let scene = Scene::random(&mut random, critic.shape);
            let got = critic.ask(&plan, &scene).unwrap();
            for (got, want) in got.iter().zip(critic.reference(&scene)) {
                for (got, want) in got.iter().zip(want) {
                    let error = (f64::from(*got) - want).abs() / (1.0 + want.abs());
                    assert!(error < 1e-5, "critic {index}, {:?}: {got}, {want}", critic.shape);
                }
            }
            for build in Build::all() {
                let other = critic.ask(&plan.clone().on(build), &scene).unwrap();
                let want = got.each_ref().map(|o| bits(o));
                assert_eq!(want, other.each_ref().map(|o| bits(o)), "{build:?}");
            }
        }
    }
}

#[test]
fn rows_of_absent_entities_are_never_read() {
    let mut random = Random::new(46);
    let critic = Critic::random(&mut random);
    let bytes = critic.plan();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    for _ in 0..40 {
        let scene = Scene::random(&mut random, critic.shape);
        let mut poisoned = scene.clone();
        for (entity, row) in poisoned.rows.chunks_mut(critic.shape.features).enumerate() {
            if !scene.present.contains(entity) {
                row.fill(f32::NAN);
            }
        }
        assert_eq!(critic.ask(&plan, &scene), critic.ask(&plan, &poisoned));
    }
}

#[test]
fn where_nobody_is_present_the_value_is_what_its_biases_say() {
    let mut random = Random::new(47);
    let critic = Critic::random(&mut random);
    let bytes = critic.plan();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut scene = Scene::random(&mut random, critic.shape);
    scene.present = EntityMask::EMPTY;
    scene.rows.fill(f32::NAN);
    let [value, entities, sums] = critic.ask(&plan, &scene).unwrap();
    assert_eq!(value, critic.head.bias);
    assert!(entities.iter().chain(&sums).all(|value| *value == 0.0));
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut random = Random::new(48);
    let critic = Critic::random(&mut random);
    let bytes = critic.plan();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut scene = Scene::random(&mut random, critic.shape);
    scene.present = EntityMask::first(1);
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let policy = PlanPolicy::new(plan.clone(), arena.as_mut_slice()).map(|_| ());
    assert_eq!(policy, Err(PlanError::WrongNetwork));
    let view = scene.view(critic.shape.features);
    let refused = plan.evaluate(arena.as_mut_slice(), &view, &mut [&mut [0.0]]);
    assert_eq!(refused, Err(DecideError::BadLength));
    let with = |change: &dyn Fn(&mut Scene)| {
        let mut scene = scene.clone();
        change(&mut scene);
        critic.ask(&plan, &scene).map(|_| ())
    };
    assert_eq!(with(&|scene| scene.rows[0] = f32::NAN), Err(DecideError::NonFinite));
    assert_eq!(with(&|scene| scene.rows.clear()), Err(DecideError::BadLength));
    assert_eq!(with(&|scene| scene.groups.clear()), Err(DecideError::BadLength));
    let (max, got) = (critic.shape.n_max, critic.shape.n_max + 1);
    let crowd = with(&|scene| scene.present = EntityMask::first(got));
    assert_eq!(crowd, Err(DecideError::TooManyEntities { max, got }));
}

#[test]
fn forged_plans_never_panic_or_leave_their_arena() {
    let mut random = Random::new(49);
    let critic = Critic::random(&mut random);
    let scene = Scene::random(&mut random, critic.shape);
    let (refused, ran) = run_forged(critic.plan().as_slice(), |plan| {
        let mut answers: Vec<Vec<f32>> = Vec::new();
        for output in plan.program().outputs() {
            let rows = match output.rows {
                OutputRows::Groups => usize::from(output.groups),
                OutputRows::Entities => scene.groups.len(),
                _ => 1,
            };
            answers.push(vec![0.0; rows * output.width as usize]);
        }
        let mut answers: Vec<&mut [f32]> = answers.iter_mut().map(Vec::as_mut_slice).collect();
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes().min(1 << 20));
        let view = scene.view(critic.shape.features);
        let _ = plan.evaluate(arena.as_mut_slice(), &view, &mut answers);
    });
    assert!(refused > 200 && ran > 200, "{refused} refused, {ran} ran");
}

#[test]
fn outputs_stand_at_the_end_and_rows_are_written_before_they_are_read() {
    let critic = Critic::random(&mut Random::new(50));
    let bytes = critic.plan();
    let program = ProgramDraft::of(Plan::load(bytes.as_slice()).unwrap().program());
    let refused = |order: &[usize]| {
        let mut program = program.clone();
        program.ops = order.iter().map(|&index| program.ops[index]).collect();
        let forged = super::networks::with_program(bytes.as_slice(), &program);
        Plan::load(forged.as_slice()).map(|_| ())
    };
    assert_eq!(refused(&[0, 1, 2, 3, 4, 5, 6, 7]), Ok(()));
    assert_eq!(refused(&[0, 2, 1, 3, 4, 5, 6, 7]), Err(PlanError::ShapeMismatch { op: 1 }));
    assert_eq!(refused(&[0, 1, 5, 2, 3, 4, 6, 7]), Err(PlanError::ShapeMismatch { op: 3 }));
    assert_eq!(refused(&[0, 1, 2, 3, 4]), Err(PlanError::ShapeMismatch { op: 5 }));
}
