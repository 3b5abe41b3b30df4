use sortie_envs::{EntitySet, Observation};
use sortie_nn::gradient_check::{assert_gradient, random};
use sortie_nn::random::stream;

use super::*;

const COLUMNS: usize = 9;
const PARTITIONS: [Partitions; 4] =
    [Partitions::None, Partitions::Drawn, Partitions::Companions, Partitions::DrawnCompanions];
const MIXERS: [MixerKind; 3] = [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix];

fn shape(kind: MixerKind, skip: bool) -> NetworkShape {
    let (input, active_inputs, width) = (COLUMNS, 3, 16);
    NetworkShape {
        agent: AgentShape { input, active_inputs, width, actions: 4, skip },
        mixer: MixerShape { kind, input, active_inputs, width, mixing: 4 },
    }
}

/// What is there in each of three states of three agents and two others, and what agents observe of it:
/// one agent of the second and one other of the third are absent, and nobody sees everything.
const PRESENT: [EntitySet; 3] = [0b11111, 0b11011, 0b01111];
const OBSERVABLE: [EntitySet; 3] = [0b11111, 0b01111, 0b10101];
const COMPANIONS: [EntitySet; 3] = [0b01011, 0b01011, 0b10100];
/// The drawn part.
const PART: EntitySet = 0b10010;

/// The states with what each agent sees of what it could observe.
fn states(seed: u64, sees: impl Fn(usize) -> EntitySet) -> Vec<Observation> {
    let state = |(index, present): (usize, EntitySet)| {
        let mut seen = Observation { present, entities: present, ..Observation::default() };
        let numbers = random(seed + index as u64, 5 * COLUMNS);
        for row in numbers.chunks(COLUMNS).take(present.count_ones() as usize) {
            seen.rows.push_dense(row);
        }
        seen.observable = (0..3).map(|agent| OBSERVABLE[agent] & sees(agent)).collect();
        seen.available = vec![0b1111, 0b1101, 0b0110];
        seen
    };
    PRESENT.into_iter().enumerate().map(state).collect()
}

fn fill(scenes: &mut Scenes, seed: u64, partitions: Partitions) {
    scenes.clear();
    for seen in states(seed, |_| EntitySet::MAX) {
        scenes.push(&seen, |agent| partitions.within(PART, COMPANIONS[agent], agent));
    }
    scenes.finish();
}

fn batch(partitions: Partitions) -> Batch {
    let mut batch = Batch::default();
    fill(&mut batch.before, 10, partitions);
    fill(&mut batch.after, 20, Partitions::None);
    batch.actions = vec![0, 3, 1, 2, 2, 0, 1, 3];
    batch.rewards = vec![0.5, -0.25, 2.0];
    batch.discounts = vec![0.9, 0.0, 0.7];
    batch
}

/// The loss that [`TemporalDifference::descend`] says it descends, from forward passes alone.
fn loss(online: &Network, targets: &[f32], batch: &Batch, imagined: Option<f32>) -> f64 {
    let shape = online.shape;
    let blocks = if imagined.is_some() { 3 } else { 1 };
    let (agent, mixer) = online.parameters.split_at(shape.agent.parameters());
    let mut pass = AgentPass::default();
    let utilities = pass.forward(shape.agent, agent, &batch.before, blocks);
    let chosen: Vec<f32> = utilities
        .chunks(4)
        .enumerate()
        .map(|(row, utilities)| utilities[usize::from(batch.actions[row % 8])])
        .collect();
    let mut pass = MixerPass::default();
    let (values, dreams) = pass.forward(
        shape.mixer,
        mixer,
        Teams { scenes: &batch.before, utilities: &chosen },
        blocks,
    );
    let mean = |values: &[f32]| {
        let errors = values.iter().zip(targets).map(|(v, t)| f64::from(v - t).powi(2));
        errors.sum::<f64>() / 3.0
    };
    let lambda = f64::from(imagined.unwrap_or(0.0));
    (1.0 - lambda) * mean(values) + lambda * mean(dreams)
}

#[test]
fn gradients_agree_with_finite_differences() {
    for partitions in PARTITIONS {
        for kind in MIXERS {
            for skip in [true, false] {
                let shape = shape(kind, skip);
                let online = Network::initialise(shape, &mut stream(1, 1, 0));
                let target = Network::initialise(shape, &mut stream(2, 1, 0));
                let batch = batch(partitions);
                let imagined = partitions.imagines().then_some(0.3);
                let mut gradient = vec![0.0; shape.parameters()];
                let mut pass = TemporalDifference::default();
                pass.descend(&online, &target, &batch, imagined, 3, &mut gradient);
                let targets = pass.targets(&online, &target, &batch).to_vec();
                for tensor in shape.tensors() {
                    let name = format!("{} of {partitions:?} {kind:?} {skip}", tensor.name);
                    let place = tensor.range;
                    let at = &online.parameters[place.clone()];
                    assert_gradient(&name, at, &gradient[place.clone()], |moved| {
                        let mut network = online.clone();
                        network.parameters[place.clone()].copy_from_slice(moved);
                        loss(&network, &targets, &batch, imagined)
                    });
                }
            }
        }
    }
}

/// Utilities of the first block and of the imagined ones.
fn utilities(partitions: Partitions, blocks: usize) -> Vec<f32> {
    let shape = shape(MixerKind::Sum, true);
    let network = Network::initialise(shape, &mut stream(3, 1, 0));
    let batch = batch(partitions);
    let mut pass = AgentPass::default();
    pass.forward(shape.agent, network.agent(), &batch.before, blocks).to_vec()
}

#[test]
fn imagined_utilities_are_those_of_agents_that_see_their_part_only() {
    for partitions in PARTITIONS {
        let shape = shape(MixerKind::Sum, true);
        let network = Network::initialise(shape, &mut stream(3, 1, 0));
        let all = utilities(partitions, 3);
        let plain = utilities(Partitions::None, 1);
        for (got, want) in all.iter().zip(&plain) {
            assert!((got - want).abs() < 1e-5, "{partitions:?}: {got} against {want}");
        }
        // Each part as if nothing else were seen.
        for (block, across) in [(1, false), (2, true)] {
            let mut scenes = Scenes::default();
            let part = |agent: usize| {
                let within = partitions.within(PART, COMPANIONS[agent], agent);
                if across { !within } else { within }
            };
            for seen in states(10, part) {
                scenes.push(&seen, |_| EntitySet::MAX);
            }
            scenes.finish();
            let mut pass = AgentPass::default();
            let want = pass.forward(shape.agent, network.agent(), &scenes, 1);
            for (got, want) in all[block * plain.len()..].iter().zip(want) {
                assert!((got - want).abs() < 1e-5, "{partitions:?}: {got} against {want}");
            }
        }
    }
}

#[test]
fn without_imagination_lambda_is_none_and_a_lambda_of_nothing_changes_no_gradient() {
    for kind in MIXERS {
        let shape = shape(kind, true);
        let online = Network::initialise(shape, &mut stream(1, 1, 0));
        let batch = batch(Partitions::Drawn);
        let [plain, imagined] = [None, Some(0.0)].map(|lambda| {
            let mut gradient = vec![0.0; shape.parameters()];
            let mut pass = TemporalDifference::default();
            pass.descend(&online, &online, &batch, lambda, 3, &mut gradient);
            gradient
        });
        for (plain, imagined) in plain.iter().zip(&imagined) {
            assert!((plain - imagined).abs() < 1e-5, "{kind:?}: {plain} against {imagined}");
        }
    }
}

#[test]
fn a_better_utility_never_makes_a_team_worse() {
    for kind in MIXERS {
        let shape = shape(kind, true).mixer;
        let network = Network::initialise(super::tests::shape(kind, true), &mut stream(4, 1, 0));
        let batch = batch(Partitions::Drawn);
        let chosen = random(5, 3 * 8);
        let mixer = &network.parameters[network.shape.agent.parameters()..];
        let mut pass = MixerPass::default();
        let teams = Teams { scenes: &batch.before, utilities: &chosen };
        pass.forward(shape, mixer, teams, 3);
        let slopes = Slopes { values: &[1.0; 3], imagined: &[1.0; 3] };
        let mut d_chosen = vec![f32::NAN; 24];
        let mut gradient = vec![0.0; shape.parameters()];
        pass.backward(shape, mixer, teams, slopes, &mut d_chosen, &mut gradient);
        assert!(d_chosen.iter().all(|slope| *slope > 0.0), "{kind:?} {d_chosen:?}");
    }
}

#[test]
fn a_partition_has_two_parts_that_do_not_meet() {
    let mut generator = stream(6, 1, 0);
    let mut sizes = [0; 6];
    for _ in 0..6000 {
        let part = Partitions::Drawn.draw(5, &mut generator);
        sizes[part.count_ones() as usize] += 1;
        for agent in 0..5 {
            let within = Partitions::Drawn.within(part, 0, agent);
            assert_eq!(within >> agent & 1, 1);
            for other in 0..5 {
                let seen = Partitions::Drawn.within(part, 0, other) >> agent & 1;
                assert_eq!(within >> other & 1, seen);
            }
        }
    }
    // With p uniform every size is as likely.
    assert!(sizes.iter().all(|count| (850..1150).contains(count)), "{sizes:?}");
}
