use sortie_envs::{ActionSet, EntitySet, Random};
use sortie_learn::learner::{Learner, Rules};
use sortie_learn::run::Rates;
use sortie_learn::subtasks::{NO_ACTION, Place};
use sortie_learn::{Act, Ask, Method, Now};
use sortie_nn::tape::Parameters;

use super::*;
use crate::alma::records::Records;
use crate::alma::records::replay::Sample;
use crate::alma::records::tests::{begin, city, play, played, samples, usual};

fn config(episode_limit: i64) -> Config {
    let mut config = usual();
    config.environment.settings.insert("episode_limit".into(), episode_limit.into());
    config.environment.instances = 3;
    config.allocator.network.width = 8;
    config
}

#[test]
fn segments_join_decisions_of_one_episode() {
    let config = config(200);
    let method = played(config.clone(), 600);
    let (city, segments) = (city(&config), &method.allocator.as_ref().unwrap().segments);
    let agents = city.spec().shape.agents;
    let seen = |decision: Moment<'_>| {
        let mut seen = Observation::default();
        city.observe(decision.state, 0, EntitySet::MAX, &mut seen);
        seen
    };
    let (mut ends, mut full) = (0, 0);
    let mut random = sortie_envs::random::generator(1);
    for _ in 0..500 {
        let place = segments.draw(1, &mut random);
        if segments.end(place) != sortie_learn::trajectory::End::Open {
            ends += 1;
            continue;
        }
        let [now, next] =
            [place, place.after(1)].map(|place| Moment::read(segments.state(place), agents));
        let (before, after) = (seen(now), seen(next));
        // The first feature of an agent that is not zero is its kind.
        let kinds = |seen: &Observation| {
            let kind = |agent| seen.rows.row(agent).next().map(|(column, _)| column);
            (0..seen.agents()).map(kind).collect::<Vec<_>>()
        };
        assert_eq!(kinds(&before), kinds(&after));
        for task in &now.allocation[..before.agents()] {
            assert!(before.open_tasks >> task & 1 == 1);
        }
        full += usize::from((segments.note(place) - 0.99_f32.powi(5)).abs() < 1e-6);
    }
    assert!(ends > 0 && full > 100, "{ends} ends, {full} full segments");
}

#[test]
fn records_reach_to_the_state_in_which_time_ran_out() {
    let config = config(5);
    let method = played(config.clone(), 40);
    let mut environment = city(&config).open(1, sortie_envs::Split::Test);
    let mut steps = |state: &[u8]| {
        environment.load(0, state).unwrap();
        environment.episode(0).steps
    };
    let mut last = [0; 2];
    for drawn in samples(&method, 300) {
        let sample = method.replay.sample(drawn);
        let [now, next] = [sample.now, sample.next].map(|moment| steps(moment.state));
        assert_eq!(now == 0, sample.now.last_actions[0] == NO_ACTION);
        if sample.discount > 0.0 {
            assert!((1..=3).contains(&(next - now)), "from step {now} to step {next}");
            if next == now + 1 {
                assert_eq!(sample.next.last_actions, sample.now.actions);
            }
            last[usize::from(next == 5)] += 1;
        }
    }
    assert!(last[0] > 50 && last[1] > 50, "{last:?}");
}

#[test]
fn samples_reach_no_further_than_their_team_and_their_subtask() {
    let config = config(200);
    let method = played(config.clone(), 600);
    let mut environment = city(&config).open(1, sortie_envs::Split::Test);
    let mut seen = Observation::default();
    let (mut moved, mut stayed) = (0, 0);
    for drawn in samples(&method, 2_000) {
        let Sample { task, now, next, discount, .. } = method.replay.sample(drawn);
        if discount == 0.0 {
            continue;
        }
        environment.observe(next.state, 0, 0, &mut seen);
        assert_eq!(seen.open_tasks >> task & 1, 1, "who goes on has something to go on with");
        let [from, to] = [now, next].map(|moment| {
            environment.load(0, moment.state).unwrap();
            environment.episode(0).steps
        });
        if to - from < 3 && to < 200 {
            assert_ne!(now.team(task), next.team(task), "from step {from} to step {to}");
            moved += 1;
        } else {
            stayed += 1;
        }
    }
    assert!(moved > 50 && stayed > 50, "{moved} {stayed}");
}

#[test]
fn instances_of_a_checkpoint_go_on() {
    let method = played(config(200), 7);
    let Records { episodes, places, .. } = &method;
    let written = serde_json::to_string(episodes).unwrap();
    assert_eq!(&serde_json::from_str::<Vec<Decisions>>(&written).unwrap(), episodes);
    for instance in 0..3 {
        let written = serde_json::to_string(places.of(instance)).unwrap();
        let read: Place = serde_json::from_str(&written).unwrap();
        let mut want = places.of(instance).clone();
        want.seen = Observation::default();
        assert_eq!(read, want);
    }
}

/// A method at play, and what was done by whom: instance, the actions that were available, the one that was taken.
struct Watched(Records, Vec<(usize, ActionSet, u16)>);

impl Method for Watched {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        self.0.begins(instance, random);
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        self.0.act(ask, now)
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let mut seen = Observation::default();
        transition.environment.observe(transition.state, 0, 0, &mut seen);
        let acted = seen.available[..seen.agents()].iter().zip(transition.actions);
        let instance = transition.instance;
        self.1.extend(acted.map(|(available, action)| (instance, *available, *action)));
        self.0.remember(transition)
    }

    fn rates(&self, now: Now) -> Rates {
        self.0.rates(now)
    }

    fn team(&self) -> Box<dyn Act + '_> {
        self.0.team()
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.0.state(state)
    }
}

#[test]
fn agents_explore_as_often_as_their_instance_and_evenly() {
    let mut config = config(200);
    (config.exploration.start, config.exploration.end) = (1.0, 1.0);
    config.exploration.spread = vec![0.0, 0.5, 1.0];
    config.allocator.decides_from = u64::MAX;
    let (play_of, mut method) = begin(&config);
    // Agents like an action the more the higher its number is.
    let shape = config.network.shape(city(&config).spec());
    let mut parameters = Parameters::default();
    shape.draw(&mut parameters, 1.0, &mut sortie_envs::random::generator(1));
    parameters.values.fill(0.0);
    let biases = shape.tensors().into_iter().find(|tensor| tensor.name == "head.bias");
    let biases = &mut parameters.values[biases.unwrap().range];
    biases.iter_mut().enumerate().for_each(|(action, bias)| *bias = action as f32);
    method.agents = Learner::new(parameters, Rules::default(), 1);
    let mut watched = (play_of, Watched(method, Vec::new()));
    play(&mut watched, 0..1500);
    // Of agents in the open, with five available actions: how often each of these was taken.
    let mut taken = [[0.0; 5]; 3];
    for (instance, available, action) in watched.1.1 {
        assert_eq!(available >> action & 1, 1, "only available actions are taken");
        if available.count_ones() == 5 {
            taken[instance][(available & ((1 << action) - 1)).count_ones() as usize] += 1.0;
        }
    }
    for (taken, epsilon) in taken.iter().zip([0.0, 0.5, 1.0]) {
        let total: f64 = taken.iter().sum();
        assert!(total > 1000.0, "{taken:?}");
        for (place, count) in taken.iter().enumerate() {
            let greedy = f64::from(u8::from(place == 4));
            let share = epsilon / 5.0 + (1.0 - epsilon) * greedy;
            assert!((count / total - share).abs() < 0.04, "{epsilon}: {taken:?}");
        }
    }
}
