use sortie_envs::{EntitySet, Observation};
use sortie_learn::learner::Shard;
use sortie_learn::networks::{EntityBatch, Moment};
use sortie_nn::gradient_check::{assert_gradient, random};
use sortie_nn::random::stream;
use sortie_nn::tape::{Parameters, Tape, Tensor};

use super::*;

const COLUMNS: usize = 9;
const PARTITIONS: [Partitions; 4] =
    [Partitions::None, Partitions::Drawn, Partitions::Companions, Partitions::DrawnCompanions];
const MIXERS: [MixerKind; 3] = [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix];

fn shape(kind: MixerKind, skip: bool) -> NetworkShape {
    let looking = LookShape { input: COLUMNS, active_inputs: 3, width: 16, heads: 4 };
    let (hypernetworks, weights_sum) = (Hypernetworks::Shared, WeightsSum::One);
    NetworkShape {
        agent: AgentShape {
            looking,
            actions: 4,
            skip,
            memory: 0,
            targets: AimedHead::Numbered.targets(&Spec::default()),
        },
        mixer: MixerShape { kind, hypernetworks, weights_sum, looking, mixing: 4 },
    }
}

fn networks(shape: NetworkShape, seed: u64) -> (Networks, Parameters) {
    Networks::new(shape, &mut stream(seed, 1, 0))
}

/// Adds to `gradient` that of the mean loss over three records.
fn descend(
    networks: &Networks,
    [online, target]: [&[f32]; 2],
    lesson: &mut Lesson,
    imagined: Option<f32>,
    gradient: &mut [f32],
) -> Losses {
    let [mut tape, mut spare] = [Tape::default(), Tape::default()];
    let pass = tape.begin(online);
    let mut shard =
        Shard { number: 0, pass, spare: &mut spare, online, target, space: &mut *lesson };
    let loss = networks.loss(&mut shard, imagined, 3);
    shard.pass.backward(loss.total, gradient);
    lesson.losses
}

/// Utilities by these weights.
fn utilities_of(
    networks: &Networks,
    weights: &[f32],
    batch: &EntityBatch,
    in_parts: bool,
) -> Vec<f32> {
    let mut tape = Tape::default();
    let mut pass = tape.begin(weights);
    let view = if in_parts { batch.seen() } else { batch.seen().whole() };
    let memory = &mut vec![0.0; batch.slots(view) * networks.agents.shape.memory];
    let utilities = networks.agents.utilities(&mut pass, batch, view, memory);
    pass.values(utilities).to_vec()
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

fn batch_of(seed: u64, partitions: Partitions, in_parts: bool) -> EntityBatch {
    let mut batch = EntityBatch::default();
    for (episode, seen) in states(seed, |_| EntitySet::MAX).into_iter().enumerate() {
        push(&mut batch, &(Moment { step: 0, episode }, seen), partitions);
    }
    batch.finish(in_parts);
    batch
}

fn records(partitions: Partitions) -> Lesson {
    let mut lesson = Lesson::default();
    lesson.before = batch_of(10, partitions, partitions.imagines());
    lesson.after = batch_of(20, Partitions::None, false);
    lesson.actions = vec![0, 3, 1, 2, 2, 0, 1, 3];
    lesson.rewards = vec![0.5, -0.25, 2.0];
    lesson.discounts = vec![0.9, 0.0, 0.7];
    lesson.next = vec![Some(0), Some(1), Some(2)];
    lesson
}

/// The loss that is descended, from forward passes alone.
fn loss(
    networks: &Networks,
    weights: &[f32],
    targets: &[f32],
    lesson: &Lesson,
    imagined: Option<f32>,
) -> f64 {
    let mut tape = Tape::default();
    let mut pass = tape.begin(weights);
    let (batch, blocks) = (&lesson.before, if imagined.is_some() { 3 } else { 1 });
    let view = if imagined.is_some() { batch.seen() } else { batch.seen().whole() };
    let memory = &mut vec![0.0; batch.slots(view) * networks.agents.shape.memory];
    let utilities = networks.agents.utilities(&mut pass, batch, view, memory);
    let chosen = pass.pick(utilities, &lesson.actions.repeat(blocks));
    let mixed = networks.mixer.mix(&mut pass, batch.teams(), chosen);
    let mean = |values| {
        let learnt = lesson.next.iter().zip(pass.values(values)).filter(|(next, _)| next.is_some());
        let errors = learnt.zip(targets).map(|((_, v), t)| f64::from(v - t).powi(2));
        errors.sum::<f64>() / 3.0
    };
    let lambda = f64::from(imagined.unwrap_or(0.0));
    (1.0 - lambda) * mean(mixed.real) + lambda * mixed.imagined.map_or(0.0, mean)
}

#[test]
fn gradients_agree_with_finite_differences() {
    for partitions in PARTITIONS {
        for kind in MIXERS {
            for skip in [true, false] {
                let mut shape = shape(kind, skip);
                shape.mixer.weights_sum = if skip { WeightsSum::One } else { WeightsSum::Agents };
                check_gradients(shape, partitions, &mut records(partitions), 1.0);
            }
        }
    }
}

/// What is descended has the slopes of the loss, with first weights that are so many times as large as usual.
fn check_gradients(shape: NetworkShape, partitions: Partitions, lesson: &mut Lesson, scale: f32) {
    let (networks, mut online) = networks(shape, 1);
    online.values.iter_mut().for_each(|parameter| *parameter *= scale);
    let target = self::networks(shape, 2).1;
    let imagined = partitions.imagines().then_some(0.3);
    let mut gradient = vec![0.0; online.values.len()];
    let both = [&*online.values, &target.values];
    descend(&networks, both, lesson, imagined, &mut gradient);
    let targets = lesson.targets.to_vec();
    // A softmax does not change with what is added to all of its scores.
    let matters = |tensor: &&Tensor| {
        tensor.name != "mixer.weights.project.bias" || shape.mixer.kind != MixerKind::Linear
    };
    for tensor in online.tensors().iter().filter(matters) {
        let name = format!("{} of {partitions:?} {shape:?}", tensor.name);
        let place = tensor.range.clone();
        let at = &online.values[place.clone()];
        assert_gradient(&name, at, &gradient[place.clone()], |moved| {
            let mut weights = online.values.clone();
            weights[place.clone()].copy_from_slice(moved);
            loss(&networks, &weights, &targets, lesson, imagined)
        });
    }
}

/// Two episodes of the states: three of the first, behind which it is over, two of the second. All show the
/// same first entity.
fn story() -> Vec<(Moment, Observation)> {
    let all = states(10, |_| EntitySet::MAX).into_iter().chain(states(20, |_| EntitySet::MAX));
    let mut all: Vec<_> = all.take(5).collect();
    let first = all[0].rows.clone();
    for seen in &mut all[1..] {
        let shown = std::mem::take(&mut seen.rows);
        seen.rows.push_row(&first, 0);
        seen.rows.end_row();
        for row in 1..shown.len() {
            seen.rows.push_row(&shown, row);
            seen.rows.end_row();
        }
    }
    let moments = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1)];
    let moments = moments.map(|(episode, step)| Moment { step, episode });
    moments.into_iter().zip(all).collect()
}

fn push(batch: &mut EntityBatch, (moment, seen): &(Moment, Observation), partitions: Partitions) {
    let within = |agent: usize| partitions.within(PART, COMPANIONS[agent], agent);
    batch.push_at(*moment, seen, within);
}

/// What was done in a state.
fn done(state: usize, seen: &Observation) -> impl Iterator<Item = u32> {
    let agents = (seen.present & 0b111).count_ones() as usize;
    (0..agents).map(move |agent| ((agent + state) % 4) as u32)
}

/// The episodes as they are learned from, of which equal rows are one, or are not.
fn episodes(shares: bool, partitions: Partitions) -> Lesson {
    let mut lesson = Lesson::default();
    lesson.before.share_rows(shares);
    for (state, (moment, seen)) in story().into_iter().enumerate() {
        lesson.actions.extend(done(state, &seen));
        push(&mut lesson.before, &(moment, seen), partitions);
    }
    lesson.next.extend([Some(1), Some(2), None, Some(4), None]);
    lesson.rewards.extend([0.5, -0.25, 0.0, 2.0, 0.0]);
    lesson.discounts.extend([0.9, 0.0, 0.0, 0.7, 0.0]);
    lesson.before.finish(partitions.imagines());
    lesson
}

/// Their steps, each with the state that followed.
fn steps_of_episodes() -> Lesson {
    let mut lesson = Lesson::default();
    let story = story();
    for (record, (state, reward, discount)) in
        [(0, 0.5, 0.9), (1, -0.25, 0.0), (3, 2.0, 0.7)].into_iter().enumerate()
    {
        lesson.before.push(&story[state].1);
        lesson.after.push(&story[state + 1].1);
        lesson.actions.extend(done(state, &story[state].1));
        lesson.rewards.push(reward);
        lesson.discounts.push(discount);
        lesson.next.push(Some(record as u32));
    }
    lesson.before.finish(false);
    lesson.after.finish(false);
    lesson
}

#[test]
fn gradients_of_whole_episodes_agree_with_finite_differences() {
    for partitions in PARTITIONS {
        for kind in MIXERS {
            for memory in [0, 6] {
                let mut shape = shape(kind, memory > 0);
                shape.agent.memory = memory;
                shape.mixer.hypernetworks = Hypernetworks::Separate;
                check_gradients(shape, partitions, &mut episodes(true, partitions), 2.1);
            }
        }
    }
}

#[test]
fn shared_rows_change_nothing() {
    for skip in [true, false] {
        let (networks, online) = networks(shape(MixerKind::Qmix, skip), 1);
        let target = self::networks(shape(MixerKind::Qmix, skip), 2).1;
        let [shared, apart] = [true, false].map(|shares| {
            let mut lesson = episodes(shares, Partitions::Drawn);
            assert_eq!(lesson.before.seen().own.is_empty(), !shares);
            let mut gradient = vec![0.0; online.values.len()];
            let both = [&*online.values, &target.values];
            let losses = descend(&networks, both, &mut lesson, Some(0.3), &mut gradient);
            (losses, gradient)
        });
        assert!((shared.0.real - apart.0.real).abs() < 1e-5, "{:?} {:?}", shared.0, apart.0);
        assert!((shared.0.imagined - apart.0.imagined).abs() < 1e-5);
        for (shared, apart) in shared.1.iter().zip(&apart.1) {
            assert!((shared - apart).abs() < 1e-5, "{shared} {apart}");
        }
    }
}

#[test]
fn whole_episodes_teach_what_their_steps_teach() {
    for kind in MIXERS {
        let (networks, online) = networks(shape(kind, true), 1);
        let target = self::networks(shape(kind, true), 2).1;
        let lessons = [episodes(true, Partitions::None), steps_of_episodes()];
        let [whole, apart] = lessons.map(|mut lesson| {
            let mut gradient = vec![0.0; online.values.len()];
            let both = [&*online.values, &target.values];
            let losses = descend(&networks, both, &mut lesson, None, &mut gradient);
            gradient.extend([losses.real as f32, losses.targets as f32]);
            gradient.extend(&lesson.targets);
            gradient
        });
        assert_eq!(whole.len(), apart.len());
        for (whole, apart) in whole.iter().zip(&apart) {
            assert!((whole - apart).abs() < 1e-5, "{kind:?}: {whole} {apart}");
        }
    }
}

/// Rewards and what they prefer by the online network, as the target network has it (double Q-learning).
#[test]
fn targets_are_what_the_target_network_says_of_what_the_online_network_prefers() {
    let (networks, online) = networks(shape(MixerKind::Sum, true), 1);
    let target = self::networks(shape(MixerKind::Sum, true), 2).1;
    for mut lesson in [records(Partitions::None), episodes(true, Partitions::None)] {
        let after = if lesson.after.is_empty() { &lesson.before } else { &lesson.after };
        let [preferred, worth] = [&online, &target]
            .map(|weights| utilities_of(&networks, &weights.values, after, false));
        let choice = |utilities: &[f32], agent: usize| {
            let row = &utilities[agent * 4..][..4];
            let open = |action: &usize| after.available()[agent] >> action & 1 == 1;
            (0..4).filter(open).max_by(|a, b| row[*a].total_cmp(&row[*b])).unwrap()
        };
        let (mut first, mut values, mut differ) = (0, Vec::new(), 0);
        for size in after.sizes() {
            let team = first..first + size;
            first += size;
            differ += team.clone().filter(|a| choice(&preferred, *a) != choice(&worth, *a)).count();
            values.push(team.map(|a| worth[a * 4 + choice(&preferred, a)]).sum::<f32>());
        }
        assert!(differ > 0);
        let both = [&*online.values, &target.values];
        descend(&networks, both, &mut lesson, None, &mut vec![0.0; online.values.len()]);
        let records = lesson.next.iter().enumerate();
        let want = records.filter_map(|(record, next)| {
            Some(lesson.rewards[record] + lesson.discounts[record] * values[(*next)? as usize])
        });
        let want: Vec<f32> = want.collect();
        assert_eq!(lesson.targets.len(), want.len());
        for (found, want) in lesson.targets.iter().zip(want) {
            assert!((found - want).abs() < 1e-5, "{found} {want}");
        }
    }
}

#[test]
fn without_imagination_lambda_is_none_and_a_lambda_of_nothing_changes_no_gradient() {
    for kind in MIXERS {
        let (networks, online) = networks(shape(kind, true), 1);
        let mut lesson = records(Partitions::Drawn);
        let [plain, imagined] = [None, Some(0.0)].map(|lambda| {
            let mut gradient = vec![0.0; online.values.len()];
            descend(&networks, [&online.values; 2], &mut lesson, lambda, &mut gradient);
            gradient
        });
        for (plain, imagined) in plain.iter().zip(&imagined) {
            assert!((plain - imagined).abs() < 1e-5, "{kind:?}: {plain} against {imagined}");
        }
    }
}

/// Partitions alone.
mod partitions {
    use sortie_nn::random::stream;

    use super::*;

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
}
