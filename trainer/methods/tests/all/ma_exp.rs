//! Intrinsic rewards against recorded ones of the dissertation's code (`tests/golden/networks-maac`), and what tables
//! hold to.

use sortie_envs::random::generator;
use sortie_envs::{SparseRows, Split, open};
use sortie_methods::ma_exp::{
    Audition, Columns, Config, Counts, Deed, Intrinsic, Learner, Outcome, Place, Selector, Shares,
    Types, Version, novelty,
};

use crate::files::safetensors_case;

#[test]
fn recorded_intrinsic_rewards_are_paid() {
    for agents in [2, 4] {
        let case = safetensors_case("networks-maac", &format!("maexp_intrinsic_n{agents}"));
        let visits = case.get("counts").f32s();
        // Agents are counted one by one: who has been nowhere else stands in a cell of its own.
        let mut counts = Counts::new(agents, 401, false);
        let stands = |agent: usize| {
            let cells = (0..400_u16).map(move |cell| (cell, usize::from(cell) + agent * 400));
            let times = |(cell, at): (u16, usize)| std::iter::repeat_n(cell, visits[at] as usize);
            cells.flat_map(times).collect::<Vec<u16>>()
        };
        let stands: Vec<Vec<u16>> = (0..agents).map(stands).collect();
        for time in 0..stands.iter().map(Vec::len).max().unwrap() {
            counts.visit(stands.iter().map(|own| own.get(time).copied().unwrap_or(400)));
        }
        let mut compared = 0;
        for update in 0..4 {
            let get = |name: &str| case.get(&format!("u{update}/{name}")).f32s();
            let [cells, recorded, rewards, variances] =
                ["cells", "novelty", "reward", "rms_var"].map(get);
            let batch = rewards.len() / (5 * agents);
            for (record, agent) in (0..batch).flat_map(|r| (0..agents).map(move |a| (r, a))) {
                let place = &cells[(record * agents + agent) * 2..][..2];
                let cell = (place[0] * 20.0 + place[1]) as u16;
                let novelties = counts.novelties(cell);
                for (other, found) in novelties.iter().enumerate() {
                    let want = recorded[(record * agents + other) * agents + agent];
                    assert!((found - want).abs() < 1e-6, "{found} {want}");
                }
                for (number, kind) in Intrinsic::CHOSEN.into_iter().enumerate() {
                    let pair = number * agents + agent;
                    let paid = kind.reward(novelties, 0.0, agent) / variances[pair].sqrt();
                    let want = rewards[pair * batch + record];
                    assert!((paid - want).abs() < 2e-6, "{kind:?} of {agent}: {paid} {want}");
                    compared += 1;
                }
            }
        }
        assert_eq!(compared, 4 * 40 * 5 * agents);
    }
}

#[test]
fn what_is_novel_to_nobody_pays_nothing_and_own_novelty_pays() {
    let kinds = Intrinsic::CHOSEN.into_iter().chain([Intrinsic::Centralized]);
    for kind in kinds {
        for agent in 0..3 {
            let paid = |own: f32, others: [f32; 2]| {
                let mut novelties = vec![others[0], others[1]];
                novelties.insert(agent, own);
                kind.reward(&novelties, own, agent)
            };
            for others in [[0.5, 0.2], [0.01, 0.9], [0.3, 0.3]] {
                assert!(paid(1e-6, others) <= 1.1e-6, "{kind:?} of {agent}");
                let grows = |steps: u32| {
                    let own = (1..=steps).map(|step| paid(step as f32 * 0.02, others));
                    own.collect::<Vec<_>>().is_sorted()
                };
                let burrows =
                    kind == Intrinsic::Burrowing || kind == Intrinsic::LeaderFollower && agent == 0;
                assert_eq!(grows(50), !burrows, "{kind:?} of {agent}");
            }
        }
    }
}

#[test]
fn places_that_one_knows_better_are_burrowed_in_and_others_covered() {
    let novelties = [novelty(9), novelty(4)];
    let paid = |kind: Intrinsic| [0, 1].map(|agent| kind.reward(&novelties, 0.25, agent));
    let [known, new] = novelties;
    for (kind, want) in [
        (Intrinsic::Independent, [known, new]),
        (Intrinsic::Minimum, [known, known]),
        (Intrinsic::Covering, [0.0, new]),
        (Intrinsic::Burrowing, [known, 0.0]),
        (Intrinsic::LeaderFollower, [known, new]),
        (Intrinsic::Centralized, [0.25, 0.25]),
    ] {
        let paid = paid(kind);
        assert!((0..2).all(|agent| (paid[agent] - want[agent]).abs() < 1e-6), "{kind:?}: {paid:?}");
    }
    assert_eq!(Intrinsic::LeaderFollower.reward(&[new, known], 0.0, 1), 0.0);
    assert_eq!(Intrinsic::Covering.reward(&[known, known], 0.0, 1), 0.0);
}

#[test]
fn the_reward_of_the_team_is_shared_out_exactly() {
    let mut shares = Shares::default();
    for (finds, reward) in [(0, -0.3), (1, 9.7), (0, -0.3), (2, 19.7), (1, 9.7)] {
        shares.add(finds, reward);
    }
    let [find, step] = shares.of(3);
    assert!((find - 10.0).abs() < 1e-5 && (step + 0.1).abs() < 1e-6, "{find} {step}");
    let mut nothing = Shares::default();
    (0..4).for_each(|_| nothing.add(0, -0.2));
    let [find, step] = nothing.of(2);
    assert_eq!((find, (step * 1e6).round()), (0.0, -100_000.0));
}

#[test]
fn an_outcome_is_the_mean_of_its_last_tries() {
    let mut outcome = Outcome::default();
    for row in [1, 2, 1, 1] {
        outcome.add(Some(row), row == 2, 100.0);
    }
    let chances = |outcome: &Outcome| -> Vec<(Option<u32>, f32)> {
        outcome.ways.iter().map(|way| (way.row, (way.chance * 100.0).round())).collect()
    };
    assert_eq!(chances(&outcome), [(Some(1), 75.0), (Some(2), 25.0)]);
    assert!((outcome.find - 0.25).abs() < 1e-6);
    // With a short memory what happens now soon counts for all that there is.
    (0..40).for_each(|_| outcome.add(None, false, 4.0));
    assert_eq!(chances(&outcome), [(Some(1), 0.0), (Some(2), 0.0), (None, 100.0)]);
    assert_eq!((outcome.tries, outcome.find < 1e-4), (44, true));
}

fn place(cell: u16) -> Place {
    Place { cell, ..Place::default() }
}

/// A corridor of three cells whose end has the treasure: who goes right from the last one finds it.
fn corridor(types: Types) -> (Learner, sortie_methods::ma_exp::Rules) {
    let mut config = Config::default();
    config.heads.intrinsic = types;
    let rules = config.rules();
    let mut learner = Learner::new(&rules, 1, 1, [-10.0, 5.0]);
    for cell in [20, 21, 22, 23] {
        learner.tables[0].row_of(place(cell));
    }
    for _ in 0..50 {
        for cell in 0..3 {
            let found = Place { cell: 23, found: 1, ..Place::default() };
            let next = if cell == 2 { found } else { place(21 + cell) };
            let is_end = cell == 2;
            let deed = Deed { rows: &[cell.into()], actions: &[3], next: &[next], is_end };
            learner.remember(&rules, &deed, if is_end { 9.9 } else { -0.1 });
        }
    }
    (learner, rules)
}

#[test]
fn values_are_what_follows_from_what_is_known() {
    let (mut learner, rules) = corridor(Types::Multi);
    learner.back_up(&rules, &[0, 1, 2]);
    let [last, middle, first] =
        [22, 21, 20].map(|cell| learner.utilities(0, Some(place(cell)), Version::Now)[3]);
    let want = [9.9, -0.1 + 0.99 * 9.9, -0.1 + 0.99 * (-0.1 + 0.99 * 9.9)];
    for (got, want) in [last, middle, first].into_iter().zip(want) {
        assert!((got - want).abs() < 1e-4, "{got} {want}");
    }
    // What was never tried stays as hopeless as it was, and as novel.
    assert_eq!(learner.utilities(0, Some(place(20)), Version::Now)[0], -10.0);
    let row = learner.tables[0].find(place(20)).unwrap();
    assert_eq!((row.actions[0].intrinsic[0], row.outcomes[3].tries), (5.0, 50));
    // Everything at once gives the same.
    let before = learner.clone();
    (0..40).for_each(|_| learner.back_up_all(&rules));
    let again = learner.utilities(0, Some(place(20)), Version::Now)[3];
    assert!((again - before.utilities(0, Some(place(20)), Version::Now)[3]).abs() < 1e-4);
}

#[test]
fn heads_are_paid_for_where_they_come_to() {
    let (mut learner, rules) = corridor(Types::One(Intrinsic::Independent));
    (0..200).for_each(|_| learner.back_up_all(&rules));
    let table = &learner.tables[0];
    let worth = |cell: u16| table.find(place(cell)).unwrap();
    let there = worth(21).here.intrinsic[0];
    assert!((worth(20).actions[3].intrinsic[0] - there).abs() < 1e-5);
    let paid = novelty(learner.counts.all()[0][21]);
    assert!((paid - 50_f32.powf(-0.7)).abs() < 1e-6, "{paid}");
    // It is after the team's reward too, and goes right from there.
    let next = worth(21).actions[3].intrinsic[0];
    assert!((there - (paid + 0.95 * next)).abs() < 1e-4, "{there} {next}");
    // The head that exploits is paid nothing.
    assert_eq!(worth(21).here.intrinsic[1], 0.95 * worth(21).actions[3].intrinsic[1]);
}

#[test]
fn pits_that_were_never_seen_are_taken_for_the_nearest_less_likely() {
    let (mut learner, rules) = corridor(Types::None);
    learner.back_up(&rules, &[2]);
    let seen = |pit: u8, found: u8| Some(Place { cell: 22, pit, found });
    assert_eq!(
        learner.utilities(0, seen(3, 0), Version::Now),
        learner.utilities(0, seen(0, 0), Version::Now)
    );
    assert_eq!(learner.utilities(0, seen(3, 1), Version::Now), [0.0, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!(learner.utilities(0, None, Version::Now), [0.0, 0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn the_frozen_policy_that_returned_most_is_deployed() {
    let (mut learner, rules) = corridor(Types::None);
    let first = Some(place(20));
    assert_eq!(learner.deployed(), Version::Now);
    learner.audition_next();
    learner.audition.add(1, 7.0);
    learner.back_up(&rules, &[0, 1, 2]);
    let learned = learner.utilities(0, first, Version::Now);
    assert_eq!(learner.utilities(0, first, Version::Tried), [-10.0; 5]);
    assert_eq!(learner.deployed(), Version::Now, "nothing was heard to its end");
    learner.audition_next();
    learner.audition.add(2, 9.0);
    assert_eq!(learner.deployed(), Version::Best);
    assert_eq!(learner.utilities(0, first, Version::Best), [-10.0; 5]);
    assert_eq!(learner.best_action(0, place(20), Version::Best), 0);
    learner.audition_next();
    learner.audition.add(3, 8.0);
    assert_eq!(learner.utilities(0, first, Version::Best), learned);
    assert_eq!(learner.best_action(0, place(20), Version::Best), 3);
    learner.tables[0].row_of(place(99));
    assert_eq!(learner.best_action(0, place(99), Version::Best), 4, "it was not known then");
}

#[test]
fn heads_that_return_more_are_chosen_more_often() {
    let mut selector = Selector::new(3);
    let mut random = generator(1);
    for head in 0..3 {
        assert_eq!(selector.choose(0.5, 1.0, &mut random), head, "untried ones first");
        selector.add(head, [-20.0, 0.0, 1.0][head]);
    }
    let mut shares = |any: f64| {
        let mut chosen = [0.0; 3];
        (0..20_000).for_each(|_| chosen[selector.choose(any, 1.0, &mut random)] += 1.0 / 20_000.0);
        chosen
    };
    let softmax = 1.0 / (1.0 + 1.0_f64.exp());
    for (any, want) in [(0.0, [0.0, softmax, 1.0 - softmax]), (1.0, [1.0 / 3.0; 3])] {
        let chosen = shares(any);
        assert!((0..3).all(|head| (chosen[head] - want[head]).abs() < 0.015), "{any}: {chosen:?}");
    }
    (0..100).for_each(|_| selector.add(0, 5.0));
    assert!((selector.means[0].unwrap() - 5.0).abs() < 0.01);
}

#[test]
fn agents_know_their_cell_the_pit_that_they_see_and_what_they_found() {
    let world = open("gridworld/task1-3", Split::Train, 1, &Default::default()).unwrap();
    let columns = Columns::of(world.spec()).unwrap();
    assert_eq!(columns.treasures(), 3);
    let at = |name: &str| world.spec().features.iter().position(|it| it == name).unwrap();
    let seen = |entries: &[(&str, f32)]| {
        let mut rows = SparseRows::default();
        let mut entries: Vec<_> = entries.iter().map(|(name, value)| (at(name), *value)).collect();
        entries.sort_by_key(|entry| entry.0);
        entries.iter().for_each(|(column, value)| rows.push(*column, *value));
        rows.end_row();
        let mut dense = vec![0.0; world.spec().shape.features];
        rows.write_dense(0, &mut dense);
        let sums = columns.weights().map(|weights| {
            weights.iter().zip(&dense).map(|(weight, number)| weight * number).sum::<f32>()
        });
        (columns.place(&rows, 0), sums)
    };
    let (place, [cell, pit, found]) = seen(&[
        ("row", 0.35),
        ("column", 0.85),
        ("pit-left", 0.1),
        ("found-0", 1.0),
        ("found-2", 1.0),
    ]);
    assert_eq!(place, Place { cell: 157, pit: 2, found: 5 });
    assert_eq!((cell.round(), pit, found), (157.0, 0.1, 5.0));
    for (chance, pit) in [(0.019, 0), (0.02, 1), (0.079, 1), (0.25, 3), (1.0, 3)] {
        assert_eq!(seen(&[("pit-here", chance), ("row", 0.05)]).0.pit, pit);
    }
    assert_eq!(seen(&[("wall-down", 1.0), ("other-0-rows", 1.0)]).0, Place::default());
    let other = open("particle/navigation-3", Split::Train, 1, &Default::default()).unwrap();
    assert_eq!(Columns::of(other.spec()), None);
}

#[test]
fn the_policy_that_returns_most_is_the_best() {
    let mut audition = Audition::default();
    assert!(audition.is_over(2) && !audition.go_on() && !audition.is_over(2));
    let mut heard = |returns: [f64; 2]| {
        audition.add(audition.number - 1, 1000.0);
        returns.iter().for_each(|it| audition.add(audition.number, *it));
        assert!(audition.is_over(2) && !audition.is_over(3));
        (audition.go_on(), audition.best)
    };
    assert_eq!(heard([-3.0, -1.0]), (true, Some(-2.0)));
    assert_eq!(heard([-4.0, -1.0]), (false, Some(-2.0)));
    assert_eq!(heard([-2.0, -1.0]), (true, Some(-1.5)));
    assert_eq!(audition.number, 4);
}

#[test]
fn visits_are_counted_by_agents_and_cells_and_teams() {
    let mut counts = Counts::new(2, 400, true);
    for cells in [[7, 399], [7, 8], [8, 7], [7, 8]] {
        counts.visit(cells.into_iter());
    }
    let visits = [(0, 7), (0, 8), (1, 8), (1, 399), (1, 7), (1, 0)];
    assert_eq!(visits.map(|(agent, cell)| counts.all()[agent][cell]), [3, 1, 2, 1, 1, 0]);
    assert_eq!(counts.novelties(7), [novelty(3), 1.0]);
    assert_eq!(counts.team_novelty([7, 8].into_iter()), novelty(2));
    assert_eq!(counts.team_novelty([8, 8].into_iter()), 1.0);
    assert_eq!(Counts::new(2, 400, false).team_novelty([7, 8].into_iter()), 0.0);
}

#[test]
fn novelty_fades_with_visits() {
    assert_eq!((novelty(0), novelty(1)), (1.0, 1.0));
    assert!((novelty(100) - 0.039_810_717).abs() < 1e-8);
    assert!((1..5000).all(|visits| novelty(visits) > novelty(visits + 1)));
}
