use super::*;
use crate::alma::records::tests::toy::{AGENTS, Street, toy};
use sortie_envs::{Rule, UNASSIGNED};
use sortie_learn::Scene;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::subtasks::Places;
use sortie_learn::trajectory::{Capacity, End, Widths};

/// Room for so many segments of one instance.
fn segments(kept: usize) -> Segments {
    Segments::noting(Capacity::States(kept), 1, Widths { tasks: 4, ..Widths::default() })
}

/// The rules of the toy: everybody to the last site, to the nearest, or to the first.
const LAST: Allocation = Allocation::Rule(0);
const NEAREST: Allocation = Allocation::Rule(1);

fn deciding(change: fn(&mut Config)) -> Deciding {
    let mut config = Config::default();
    change(&mut config);
    Deciding::new(&config, toy().spec())
}

#[test]
fn allocators_are_drawn_by_their_weights() {
    let deciding = deciding(|config| config.allocation.heuristic = 3.0);
    let mut random = generator(1, Purpose::Rollout, 0);
    let drawn: Vec<_> = (0..4000).map(|_| deciding.draw(&mut random)).collect();
    let share = |who| drawn.iter().filter(|drawn| **drawn == who).count() as f64 / 4000.0;
    assert!((share(Allocation::Learned) - 0.25).abs() < 0.03);
    assert!((share(NEAREST) - 0.75).abs() < 0.03);
}

#[test]
fn who_learns_decides_or_is_stood_in_for_and_nothing_else_is_tried_out() {
    let (environment, street) = (toy(), Street::new(6, &[3, 4, 14]));
    let state = street.bytes();
    let mut random = generator(1, Purpose::Rollout, 0);
    let mut by = |rule: Allocation| {
        let mut allocation = vec![UNASSIGNED; AGENTS];
        environment.allocate(rule.rule(), &state, &mut random, &mut allocation);
        allocation
    };
    let [last, nearest] = [LAST, NEAREST].map(&mut by);
    assert_ne!(last, nearest);
    let decided = |allocation_by, learns: bool, moved_decisions| {
        let mut config = Config::default();
        (config.allocator.moved, config.allocator.moved_decisions) = (1.0, moved_decisions);
        let stand_in = NEAREST;
        let mut episode = Decisions { allocation_by, stand_in, ..Decisions::new(0) };
        let (mut random, mut segments) = (generator(1, Purpose::Rollout, 0), segments(10));
        let segments = learns.then_some(&mut segments);
        let mut deciding = Deciding::new(&config, environment.spec());
        let (mut places, now) = (Places::new(5), (&environment as &dyn Environment, &*state));
        let scene = Scene { instance: 0, state: &state, begins: true, tasks_changed: false };
        let place = places.look(&environment, &scene);
        deciding.decide(&mut episode, now, place, &mut random, None, segments).unwrap();
        place.allocation.clone()
    };
    assert_eq!(decided(Allocation::Learned, true, 0.0), nearest, "the episode's stand-in");
    assert_ne!(decided(Allocation::Learned, true, 1.0), nearest, "and agents are moved");
    assert_eq!(decided(Allocation::Learned, false, 1.0), last, "nobody learns");
    assert_eq!(decided(NEAREST, true, 1.0), nearest, "a rule is not explored");
}

#[test]
fn an_episode_is_decided_by_whom_the_run_asks_for() {
    let by = |change| {
        let mut episode = Decisions::new(0);
        episode.restart(&deciding(change), &mut generator(1, Purpose::Rollout, 0));
        episode.allocation_by
    };
    let heuristic = |config: &mut Config| {
        (config.allocation.learned, config.allocation.heuristic) = (0.0, 1.0);
    };
    assert_eq!(by(heuristic), NEAREST);
    assert_eq!(by(|config| config.allocation.rule = "coordinated".to_owned()), LAST);
}

/// The first two rules whatever they are called; of one rule that alone.
#[test]
fn the_first_rules_stand_in() {
    let stand_ins = |names: &'static [&'static str]| {
        let rules = names.iter().map(|name| Rule::new(name, "")).collect();
        let spec = Spec { rules, ..toy().spec().clone() };
        let deciding = Deciding::new(&Config::default(), &spec);
        let mut episode = Decisions::new(0);
        let mut random = generator(1, Purpose::Rollout, 0);
        let drawn = (0..50).map(|_| {
            episode.restart(&deciding, &mut random);
            assert_eq!(episode.allocation_by, Allocation::Learned);
            episode.stand_in.rule()
        });
        drawn.collect::<std::collections::BTreeSet<_>>()
    };
    assert!(stand_ins(&["dynamic", "matching", "random"]).into_iter().eq([0, 1]));
    assert!(stand_ins(&["dynamic"]).into_iter().eq([0]));
}

#[test]
fn a_share_of_the_agents_moves_to_open_sites_with_room() {
    let mut random = generator(1, Purpose::Rollout, 0);
    // Of so many times eight agents who are all at the second site.
    let mut moved = |share, team_max, sites: &[(u8, bool)], times| {
        let seen = Street { sites: sites.to_vec(), ..Street::new(8, &[]) }.seen();
        let mut counts = [0; 3];
        for _ in 0..times {
            let mut allocation = vec![1; AGENTS];
            move_some(&seen, share, team_max, &mut random, &mut allocation);
            allocation.iter().for_each(|task| counts[usize::from(*task)] += 1);
        }
        counts
    };
    let sites = [(1, true), (5, false), (9, true)];
    assert_eq!(moved(0.0, 8, &sites, 1), [0, 8, 0]);
    assert_eq!(moved(1.0, 8, &sites[1..2], 1), [0, 8, 0], "nothing is open");
    assert_eq!(moved(1.0, 3, &sites, 1), [3, 2, 3], "a team of three is full");
    let [first, _, second]: [i32; 3] = moved(0.25, 8, &sites, 125);
    assert!(first.abs_diff(125) < 40 && second.abs_diff(125) < 40, "{first}, {second}");
}

#[test]
fn rewards_of_a_segment_are_discounted_step_by_step() {
    let (environment, state) = (toy(), Street::new(1, &[3, 9]).bytes());
    let mut segments = segments(10);
    let mut episode = Decisions::new(0);
    let earn = |episode: &mut Decisions, rewards, step, segments: &mut Segments| {
        let transition = Transition {
            environment: &environment,
            instance: 0,
            state: &state,
            actions: &[0; AGENTS],
            step,
            task_rewards: rewards,
            agent_rewards: &[],
            next: &state,
        };
        episode.remember(&transition, 0.5, Some(segments));
    };
    let allocate = |episode: &mut Decisions, task, segments: &mut Segments| {
        let mut allocation = [UNASSIGNED; AGENTS];
        allocation[0] = task;
        episode.begin_segment((&environment, &state), &allocation, segments);
    };
    let (open, terminated) = (Step::default(), Step { terminated: true, ..Step::default() });
    let timed_out = Step { timed_out: true, ..Step::default() };
    allocate(&mut episode, 1, &mut segments);
    for rewards in [&[1.0, 0.0][..], &[2.0, 8.0], &[4.0, 16.0]] {
        earn(&mut episode, rewards, open, &mut segments);
    }
    allocate(&mut episode, 0, &mut segments);
    earn(&mut episode, &[3.0, 5.0], terminated, &mut segments);
    allocate(&mut episode, 1, &mut segments);
    earn(&mut episode, &[1.0, 1.0], timed_out, &mut segments);

    let first = segments.oldest(0);
    let found = |number| {
        let place = first.after(number);
        let decision = Moment::read(segments.state(place), AGENTS);
        assert_eq!(decision.state, state);
        let rewards = segments.rewards(place).tasks;
        let (end, task) = (segments.end(place), decision.allocation[0]);
        (task, rewards[0], rewards[1], *segments.note(place), end)
    };
    let rewards = (1.0 + 0.5 * 2.0 + 0.25 * 4.0, 0.5 * 8.0 + 0.25 * 16.0);
    assert_eq!(found(0), (1, rewards.0, rewards.1, 0.125, End::Open));
    assert_eq!(found(1), (0, 3.0, 5.0, 0.5, End::Over));
    assert_eq!(segments.end(first.after(2)), End::Nothing);
    assert_eq!(found(3), (1, 1.0, 1.0, 0.5, End::TimedOut), "no decision follows");
    assert!(episode.segment.is_none(), "a new episode joins nothing");
}
