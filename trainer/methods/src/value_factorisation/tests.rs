use std::collections::BTreeMap;

use sortie_envs::{EntitySet, Observation};
use sortie_nn::gradient_check::{assert_gradient, random};
use sortie_nn::random::stream;

use super::looking::Tensor;
use super::*;

const COLUMNS: usize = 9;
const PARTITIONS: [Partitions; 4] =
    [Partitions::None, Partitions::Drawn, Partitions::Companions, Partitions::DrawnCompanions];
const MIXERS: [MixerKind; 3] = [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix];

fn shape(kind: MixerKind, skip: bool) -> NetworkShape {
    let (input, active_inputs, width) = (COLUMNS, 3, 16);
    let hypernetworks = Hypernetworks::Shared;
    NetworkShape {
        agent: AgentShape { input, active_inputs, width, actions: 4, skip, memory: 0 },
        mixer: MixerShape { kind, hypernetworks, input, active_inputs, width, mixing: 4 },
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
fn loss(online: &Network, targets: &[Option<f32>], batch: &Batch, imagined: Option<f32>) -> f64 {
    let shape = online.shape;
    let blocks = if imagined.is_some() { 3 } else { 1 };
    let (agent, mixer) = online.parameters.split_at(shape.agent.parameters());
    let mut pass = AgentPass::default();
    let utilities = pass.forward(shape.agent, agent, &batch.before, blocks);
    let chosen: Vec<f32> = utilities
        .chunks(4)
        .enumerate()
        .map(|(row, utilities)| utilities[usize::from(batch.actions[row % batch.before.agents()])])
        .collect();
    let mut pass = MixerPass::default();
    let (values, dreams) = pass.forward(
        shape.mixer,
        mixer,
        Teams { scenes: &batch.before, utilities: &chosen },
        blocks,
    );
    let mean = |values: &[f32]| {
        let errors =
            values.iter().zip(targets).filter_map(|(v, t)| Some(f64::from(v - (*t)?).powi(2)));
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
                check_gradients(shape(kind, skip), partitions, &batch(partitions), 1.0);
            }
        }
    }
}

/// What is descended has the slopes of the loss, with first weights that are so many times as large as usual.
fn check_gradients(shape: NetworkShape, partitions: Partitions, batch: &Batch, scale: f32) {
    let mut online = Network::initialise(shape, &mut stream(1, 1, 0));
    online.parameters.iter_mut().for_each(|parameter| *parameter *= scale);
    let target = Network::initialise(shape, &mut stream(2, 1, 0));
    let imagined = partitions.imagines().then_some(0.3);
    let mut gradient = vec![0.0; shape.parameters()];
    let mut pass = TemporalDifference::default();
    pass.descend(&online, &target, batch, imagined, 3, &mut gradient);
    let targets = pass.targets().to_vec();
    // A softmax does not change with what is added to all of its scores.
    let matters = |tensor: &Tensor| {
        tensor.name != "mixer.weights.project.bias" || shape.mixer.kind != MixerKind::Linear
    };
    for tensor in shape.tensors().into_iter().filter(matters) {
        let name = format!("{} of {partitions:?} {shape:?}", tensor.name);
        let place = tensor.range;
        let at = &online.parameters[place.clone()];
        assert_gradient(&name, at, &gradient[place.clone()], |moved| {
            let mut network = online.clone();
            network.parameters[place.clone()].copy_from_slice(moved);
            loss(&network, &targets, batch, imagined)
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

fn push(scenes: &mut Scenes, (moment, seen): &(Moment, Observation), partitions: Partitions) {
    let within = |agent: usize| partitions.within(PART, COMPANIONS[agent], agent);
    scenes.push_at(*moment, seen, within);
}

/// What was done in a state.
fn done(state: usize, seen: &Observation) -> impl Iterator<Item = u16> {
    let agents = (seen.present & 0b111).count_ones() as usize;
    (0..agents).map(move |agent| ((agent + state) % 4) as u16)
}

/// The episodes as they are learned from, so many times.
fn episodes_times(scenes: Scenes, partitions: Partitions, times: usize) -> Batch {
    let mut batch = Batch { before: scenes, ..Batch::default() };
    for time in 0..times {
        for (state, (moment, seen)) in story().into_iter().enumerate() {
            let moment = Moment { episode: moment.episode + 2 * time, ..moment };
            push(&mut batch.before, &(moment, seen.clone()), partitions);
            batch.actions.extend(done(state + time, &seen));
        }
        let next = [Some(1), Some(2), None, Some(4), None];
        batch.next.extend(next.map(|next| Some(next? + 5 * time)));
        batch.rewards.extend([0.5, -0.25, 0.0, 2.0, 0.0]);
        batch.discounts.extend([0.9, 0.0, 0.0, 0.7, 0.0]);
    }
    batch.before.finish();
    batch
}

fn episodes(scenes: Scenes, partitions: Partitions) -> Batch {
    episodes_times(scenes, partitions, 1)
}

/// Their steps, each with the state that followed.
fn steps_of_episodes() -> Batch {
    let mut batch = Batch::default();
    let story = story();
    for (state, reward, discount) in [(0, 0.5, 0.9), (1, -0.25, 0.0), (3, 2.0, 0.7)] {
        batch.before.push(&story[state].1, |_| EntitySet::MAX);
        batch.after.push(&story[state + 1].1, |_| EntitySet::MAX);
        batch.actions.extend(done(state, &story[state].1));
        batch.rewards.push(reward);
        batch.discounts.push(discount);
    }
    batch.before.finish();
    batch.after.finish();
    batch
}

#[test]
fn gradients_of_whole_episodes_agree_with_finite_differences() {
    for partitions in PARTITIONS {
        for kind in MIXERS {
            for memory in [0, 6] {
                let mut shape = shape(kind, memory > 0);
                shape.agent.memory = memory;
                shape.mixer.hypernetworks = Hypernetworks::Separate;
                let batch = episodes(Scenes::sharing(), partitions);
                check_gradients(shape, partitions, &batch, 2.1);
            }
        }
    }
}

#[test]
fn shared_rows_change_nothing() {
    // Few pairs, and so many that scores are taken of rows by rows.
    for (skip, times) in [(true, 1), (false, 1), (true, 12), (false, 12)] {
        let shape = shape(MixerKind::Qmix, skip);
        let online = Network::initialise(shape, &mut stream(1, 1, 0));
        let target = Network::initialise(shape, &mut stream(2, 1, 0));
        let [shared, apart] = [Scenes::sharing(), Scenes::default()].map(|scenes| {
            let batch = episodes_times(scenes, Partitions::Drawn, times);
            assert_eq!(
                batch.before.seen().is_by_rows(),
                times > 1 && !batch.before.seen().own.is_empty()
            );
            let mut gradient = vec![0.0; shape.parameters()];
            let mut pass = TemporalDifference::default();
            let losses =
                pass.descend(&online, &target, &batch, Some(0.3), 3 * times, &mut gradient);
            (losses, gradient)
        });
        let times = times as f64;
        assert!(
            (shared.0.real - apart.0.real).abs() < 1e-5 * times,
            "{:?} {:?}",
            shared.0,
            apart.0
        );
        assert!((shared.0.imagined - apart.0.imagined).abs() < 1e-5 * times);
        for (shared, apart) in shared.1.iter().zip(&apart.1) {
            assert!((shared - apart).abs() < 1e-5, "{shared} {apart}");
        }
    }
}

#[test]
fn whole_episodes_teach_what_their_steps_teach() {
    for kind in MIXERS {
        let shape = shape(kind, true);
        let online = Network::initialise(shape, &mut stream(1, 1, 0));
        let target = Network::initialise(shape, &mut stream(2, 1, 0));
        let batches = [episodes(Scenes::sharing(), Partitions::None), steps_of_episodes()];
        let [whole, apart] = batches.map(|batch| {
            let mut pass = TemporalDifference::default();
            let mut gradient = vec![0.0; shape.parameters()];
            let losses = pass.descend(&online, &target, &batch, None, 3, &mut gradient);
            let targets: Vec<f32> = pass.targets().iter().flatten().copied().collect();
            gradient.extend([losses.real as f32, losses.targets as f32]);
            gradient.extend(targets);
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
    let shape = shape(MixerKind::Sum, true);
    let online = Network::initialise(shape, &mut stream(1, 1, 0));
    let target = Network::initialise(shape, &mut stream(2, 1, 0));
    let whole = episodes(Scenes::sharing(), Partitions::None);
    for batch in [batch(Partitions::None), whole] {
        let after = if batch.next.is_empty() { &batch.after } else { &batch.before };
        let [preferred, worth] = [&online, &target].map(|network| {
            AgentPass::default().forward(shape.agent, network.agent(), after, 1).to_vec()
        });
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
        let mut pass = TemporalDifference::default();
        let records = batch.rewards.len();
        pass.descend(&online, &target, &batch, None, records, &mut vec![0.0; shape.parameters()]);
        for (record, found) in pass.targets().iter().enumerate() {
            let next = if batch.next.is_empty() { Some(record) } else { batch.next[record] };
            let want =
                next.map(|next| batch.rewards[record] + batch.discounts[record] * values[next]);
            match (found, want) {
                (Some(found), Some(want)) => assert!((found - want).abs() < 1e-5, "{found} {want}"),
                (found, want) => assert_eq!(*found, want),
            }
        }
    }
}

/// Agents that go through an episode at once remember what those do that go step by step.
#[test]
fn agents_remember_from_step_to_step_and_begin_with_nothing() {
    let mut shape = shape(MixerKind::Sum, true);
    shape.agent.memory = 6;
    let network = Network::initialise(shape, &mut stream(5, 1, 0));
    let whole = episodes(Scenes::sharing(), Partitions::None).before;
    let mut pass = AgentPass::default();
    let whole = pass.forward(shape.agent, network.agent(), &whole, 1).to_vec();
    let (mut memory, mut apart) = (Vec::new(), Vec::new());
    for (Moment { step, .. }, seen) in story() {
        if step == 0 {
            memory = vec![0.0; 3 * 6];
        }
        let mut scenes = Scenes::default();
        scenes.push(&seen, |_| EntitySet::MAX);
        scenes.finish();
        let scenes = (&scenes, 1);
        let memory = Some(&mut *memory);
        apart.extend_from_slice(pass.forward_from(shape.agent, network.agent(), scenes, memory));
    }
    assert_eq!(whole.len(), apart.len());
    for (whole, apart) in whole.iter().zip(&apart) {
        assert!((whole - apart).abs() < 1e-5, "{whole} {apart}");
    }
}

/// What three agents with so much memory remember of each instance behind states that they saw: of every time that they acted
/// whose teams, whether the team's episode began, and the state's number.
fn remembered(times: &[&[(usize, bool, usize)]]) -> BTreeMap<usize, Vec<f32>> {
    let mut shape = shape(MixerKind::Sum, true);
    shape.agent.memory = 6;
    let network = Network::initialise(shape, &mut stream(5, 1, 0));
    let states = states(10, |_| EntitySet::MAX);
    let mut acting = Acting::default();
    for teams in times {
        acting.clear();
        for (instance, begins, state) in *teams {
            acting.push(*instance, *begins, &states[*state]);
        }
        acting.choose(&network, &mut [0; 6]);
    }
    acting.memories
}

#[test]
fn who_acts_remembers_its_own_episode_and_nothing_of_the_one_before() {
    let once = remembered(&[&[(0, true, 0)]]);
    assert!(once[&0].iter().all(|number| *number != 0.0));
    let twice = remembered(&[&[(0, true, 0)], &[(0, false, 2)]]);
    assert_ne!(twice[&0], remembered(&[&[(0, true, 2)]])[&0]);
    let anew = remembered(&[&[(0, true, 2)], &[(0, false, 1)], &[(0, true, 0)]]);
    assert_eq!(anew[&0], once[&0]);
    // Whoever is absent remembers nothing.
    let absent = remembered(&[&[(0, true, 0)], &[(0, false, 1)]]);
    assert_eq!(absent[&0][2 * 6..], [0.0; 6]);
    assert!(absent[&0][..2 * 6].iter().all(|number| *number != 0.0));
    // Teams act side by side, in any order.
    let both = remembered(&[&[(5, true, 2), (0, true, 0)], &[(0, false, 2), (5, false, 0)]]);
    let other = remembered(&[&[(0, true, 2)], &[(0, false, 0)]]);
    for (both, alone) in [(&both[&0], &twice[&0]), (&both[&5], &other[&0])] {
        for (both, alone) in both.iter().zip(alone) {
            assert!((both - alone).abs() < 1e-6, "{both} {alone}");
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
