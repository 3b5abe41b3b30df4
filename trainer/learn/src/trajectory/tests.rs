use sortie_envs::{Environment, Split, Step};
use sortie_nn::random::stream;

use super::*;

/// A number as a state: so many bytes of it.
fn bytes(state: usize) -> Vec<u8> {
    vec![state as u8; 1 + state % 5]
}

struct World(Box<dyn Environment>);

impl World {
    fn new() -> Self {
        Self(
            sortie_envs::open("group-matching/3x6x1", Split::Train, 1, &Default::default())
                .unwrap(),
        )
    }

    /// Adds a step of an instance from one state to another that earns the number of the state; the first subtask and the
    /// second agent earn more.
    fn push(&self, replay: &mut Trajectories, instance: usize, states: [usize; 2], end: End) {
        self.push_noted(replay, instance, states, (end, ()));
    }

    /// The same, and notes something of it.
    fn push_noted<N: Clone + Default + Serialize + DeserializeOwned>(
        &self,
        replay: &mut Trajectories<N>,
        instance: usize,
        [state, next]: [usize; 2],
        (end, note): (End, N),
    ) -> Place {
        let reward = state as f64;
        let (terminated, timed_out) = (end == End::Over, end == End::TimedOut);
        let transition = Transition {
            environment: &*self.0,
            instance,
            state: &bytes(state),
            actions: &[state as u16, 7, 9],
            step: Step { reward, terminated, timed_out, ..Step::default() },
            task_rewards: &[reward + 0.25],
            agent_rewards: &[0.0, reward + 0.5],
            next: &bytes(next),
        };
        replay.push_noted(&transition, note)
    }
}

const WIDTHS: Widths = Widths { agents: 2, tasks: 2, earners: 2 };

fn at(number: u64) -> Place {
    Place { instance: 0, number }
}

/// Two episodes of three steps each: the first is over, the second ran out of time; then an open one.
fn three() -> Trajectories {
    let (world, mut replay) = (World::new(), Trajectories::new(Capacity::States(64), 1, WIDTHS));
    for (episode, last) in [End::Over, End::TimedOut, End::Open].into_iter().enumerate() {
        for (step, end) in [End::Open, End::Open, last].into_iter().enumerate() {
            let state = 10 * episode + step;
            world.push(&mut replay, 0, [state, state + 1], end);
        }
    }
    replay
}

#[test]
fn a_future_ends_with_its_episode() {
    let replay = three();
    let future = |number, steps| {
        let future = replay.future(at(number), steps, 0.5);
        (replay.state(future.place)[0], future.reward, future.discount)
    };
    assert_eq!(future(0, 1), (1, 0.0, 0.5));
    assert_eq!(future(0, 2), (2, 0.5, 0.25));
    assert_eq!(future(0, 5), (3, 0.5 + 0.5, 0.0));
    assert_eq!(future(5, 5), (13, 11.0 + 6.0, 0.25));
    assert_eq!(future(8, 2), (22, 20.0 + 10.5, 0.25));
    assert_eq!(future(3, 2), (3, 0.0, 0.0));
}

#[test]
fn steps_are_kept_as_they_were() {
    let replay = three();
    for (number, state) in [0, 1, 2, 3, 10, 11, 12, 13, 20, 21, 22].into_iter().enumerate() {
        let place = at(0).after(number);
        assert_eq!((replay.state(place), place.since(at(0))), (&*bytes(state), number));
        if state % 10 == 3 {
            assert_eq!(replay.end(place), End::Nothing);
            continue;
        }
        let earned = state as f32;
        let want =
            Rewards { team: earned, tasks: &[earned + 0.25, 0.0], agents: &[0.0, earned + 0.5] };
        assert_eq!(replay.rewards(place), want);
        assert_eq!(replay.actions(place), [state as u16, 7]);
    }
    assert!(replay.has(at(10)) && !replay.has(at(11)));
}

#[test]
fn only_states_with_actions_and_a_future_are_drawn() {
    let (replay, mut random, mut drawn) = (three(), stream(1, 1, 0), [0; 30]);
    for _ in 0..2000 {
        let place = replay.draw(2, &mut random);
        drawn[usize::from(replay.state(place)[0])] += 1;
    }
    let states: Vec<usize> = (0..30).filter(|state| drawn[*state] > 0).collect();
    assert_eq!(states, [0, 1, 2, 10, 11, 12, 20]);
    assert!(states.iter().all(|state| drawn[*state] > 200), "{drawn:?}");
}

/// Over many blocks, and with what was stored before in their memory.
#[test]
fn the_oldest_states_give_way() {
    let (world, mut random) = (World::new(), stream(1, 1, 0));
    let mut replay = Trajectories::new(Capacity::States(300), 2, WIDTHS);
    for number in 0..3_000 {
        world.push(&mut replay, 1, [number % 200, (number + 1) % 200], End::Open);
        let place = Place { instance: 1, number: number as u64 };
        assert_eq!(replay.state(place), bytes(number % 200));
        assert_eq!(
            (replay.has(place), replay.has(Place { number: 3_000, ..place })),
            (true, false)
        );
        let oldest = Place { number: (number as u64 + 1).saturating_sub(300), ..place };
        assert!(
            replay.has(oldest)
                && oldest
                    .number
                    .checked_sub(1)
                    .is_none_or(|number| { !replay.has(Place { number, ..place }) })
        );
        assert_eq!(replay.state(oldest), bytes(oldest.number as usize % 200));
    }
    assert!(replay.streams[1].blocks.len() + replay.streams[1].spare.len() <= 4);
    let draws = (0..5_000).map(|_| replay.draw(2, &mut random).number);
    let (least, most) = draws.fold((u64::MAX, 0), |(a, b), at| (a.min(at), b.max(at)));
    assert_eq!((least, most), (2_700, 2_997));
}

#[test]
fn different_episodes_are_drawn_each_as_often() {
    let (world, mut replay) = (World::new(), Trajectories::new(Capacity::Episodes(5), 2, WIDTHS));
    for episode in 0..7 {
        for step in 0..3 {
            let end = if step < 2 { End::Open } else { End::Over };
            let states = [10 * episode + step, 10 * episode + step + 1];
            world.push(&mut replay, 0, states, end);
            // The other instance never ends.
            world.push(&mut replay, 1, states, End::Open);
        }
    }
    assert_eq!((replay.finished(), replay.episodes()), (7, 5));
    let (mut drawn, mut random, mut counts) = (Vec::new(), stream(1, 1, 0), [0; 70]);
    for _ in 0..2_000 {
        replay.draw_episodes(3, &mut random, &mut drawn);
        assert!(drawn.iter().all(|episode| episode.steps == 3));
        drawn.iter().for_each(|it| counts[usize::from(replay.state(it.first)[0])] += 1);
        drawn.sort_unstable_by_key(|episode| episode.first);
        drawn.dedup();
        assert_eq!(drawn.len(), 3);
    }
    // The first two gave way; of five three are drawn 2,000 times.
    let kept = [20, 30, 40, 50, 60].map(|state| counts[state]);
    assert_eq!(kept.iter().sum::<usize>(), 6_000);
    assert!(kept.iter().all(|count| (1_100..1_300).contains(count)), "{kept:?}");
    assert!(replay.has(at(8)) && !replay.has(at(7)), "what is of no episode is forgotten");
    assert!(replay.has(Place { instance: 1, number: 0 }), "a running episode is kept");
}

#[test]
fn the_latest_episodes_come_in_the_order_in_which_they_ended() {
    let (world, mut replay) = (World::new(), Trajectories::new(Capacity::Episodes(4), 2, WIDTHS));
    for (episode, instance) in [1, 0, 0, 1, 0].into_iter().enumerate() {
        world.push(&mut replay, instance, [10 * episode, 0], End::Over);
    }
    let firsts = |count| -> Vec<u8> {
        replay.latest(count).map(|episode| replay.state(episode.first)[0]).collect()
    };
    assert_eq!((firsts(2), firsts(9)), (vec![30, 40], vec![10, 20, 30, 40]));
}

/// Whether states or whole episodes are kept: states in which nothing was done earned nothing.
#[test]
fn rewards_are_in_deviations_of_what_is_kept() {
    let world = World::new();
    for (capacity, kept) in [(Capacity::States(8), 3..9), (Capacity::Episodes(2), 3..9)] {
        let mut replay = Trajectories::new(capacity, 1, WIDTHS);
        for state in 0..9 {
            let end = [End::Open, End::Open, End::Over][state % 3];
            world.push(&mut replay, 0, [state, state + 1], end);
        }
        let earned: Vec<f32> = kept.map(|state| state as f32 + 0.5).collect();
        let mean = earned.iter().sum::<f32>() / 6.0;
        let deviation = (35.0_f32 / 12.0).sqrt();
        let found = replay.in_deviations(1, 7.5);
        assert!((found - (7.5 - mean) / deviation).abs() < 1e-6, "{capacity:?} {found}");
        // Of who always earns the same, nothing is learned.
        assert_eq!(replay.in_deviations(0, 0.0), 0.0);
    }
}

#[test]
fn a_checkpoint_brings_back_what_goes_on_as_before() {
    let (world, mut replay) = (World::new(), three());
    let mut written = crate::run::checkpoint::Written::default();
    replay.visit(&mut State::write(&mut written)).unwrap();
    let bytes = &written.values["trajectories"];
    let mut again: Trajectories = postcard::from_bytes(bytes).unwrap();
    for replay in [&mut replay, &mut again] {
        (23..400).for_each(|state| world.push(replay, 0, [state, state + 1], End::Open));
    }
    assert_eq!(postcard::to_stdvec(&replay).unwrap(), postcard::to_stdvec(&again).unwrap());
}

#[test]
fn notes_stay_with_their_steps_and_can_be_changed() {
    let (world, capacity) = (World::new(), Capacity::States(300));
    let mut replay: Trajectories<u32> = Trajectories::noting(capacity, 2, WIDTHS);
    let mut places = Vec::new();
    for number in 0..700 {
        let end = if number % 50 == 49 { End::Over } else { End::Open };
        let place = world.push_noted(&mut replay, 1, [0, 1], (end, number));
        *replay.note_mut(place) += 1_000;
        assert_eq!(place.instance(), 1);
        places.push(place);
    }
    for (number, place) in places.into_iter().enumerate().filter(|(_, place)| replay.has(*place)) {
        assert_eq!(*replay.note(place), 1_000 + number as u32);
        if replay.end(place) == End::Over {
            assert_eq!(*replay.note(place.after(1)), 0, "of what an episode ended in");
        }
    }
}

#[test]
fn a_slot_is_that_of_the_latest_state_in_it() {
    let (world, kept) = (World::new(), 7);
    let mut replay = Trajectories::new(Capacity::States(kept), 2, WIDTHS);
    assert_eq!(replay.slots(), 14);
    for number in 0..30 {
        let place = world.push_noted(&mut replay, 1, [number, number + 1], (End::Open, ()));
        assert_eq!(replay.slot(place), kept + number % kept);
        for age in 0..kept.min(number + 1) {
            let place = Place { number: (number - age) as u64, ..place };
            assert_eq!(replay.at(replay.slot(place)), place, "{number} {age}");
        }
    }
}
