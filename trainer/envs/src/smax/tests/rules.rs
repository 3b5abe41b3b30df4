//! Rules that recorded episodes do not show, or not at their bounds.

use super::super::battle::{ATTACK, Battle, CAPACITY, NOBODY, STOP, TICK, Unit};
use super::super::environment::jitter;
use super::super::scenarios::Roster;
use super::super::units::{AttackMode, RANGE, RuleBook, Rules, SIGHT};
use super::{saved, smax};
use crate::random::{Random, generator};
use crate::{Environment, observe_and_step};

const MARINE: u8 = 0;
const STALKER: u8 = 2;
const ZEALOT: u8 = 3;
const NORTH: u8 = 0;
const EAST: u8 = 1;
const SOUTH: u8 = 2;
const WEST: u8 = 3;

/// A battle of units at these places, all of whom stop.
fn battle(allies: &[(u8, [f32; 2])], enemies: &[(u8, [f32; 2])]) -> Battle {
    let kinds = |team: &[(u8, [f32; 2])]| team.iter().map(|(kind, _)| *kind).collect::<Vec<_>>();
    let mut battle = Battle::of(&kinds(allies), &kinds(enemies));
    let places = allies.iter().chain(enemies).map(|(_, place)| *place);
    battle.units.iter_mut().zip(places).for_each(|(unit, place)| unit.place = place);
    battle
}

/// What enemies do by the rule, where nothing is left to chance.
fn commanded(battle: &Battle, rules: &Rules) -> Battle {
    let mut battle = battle.clone();
    battle.command(rules, |_, among| panic!("a draw among {among:b}"));
    battle
}

fn orders(battle: &Battle) -> Vec<u8> {
    battle.units[battle.allies..battle.count].iter().map(|enemy| enemy.order).collect()
}

#[test]
fn sets_have_the_published_teams() {
    let count = |set: &str| Roster::named(set).unwrap().most();
    for (set, allies, enemies) in [
        ("3m", 3, 3),
        ("8m", 8, 8),
        ("25m", 25, 25),
        ("2s3z", 5, 5),
        ("3s5z", 8, 8),
        ("5m_vs_6m", 5, 6),
        ("10m_vs_11m", 10, 11),
        ("27m_vs_30m", 27, 30),
        ("3s5z_vs_3s6z", 8, 9),
        ("3s_vs_5z", 3, 5),
        ("6h_vs_8z", 6, 8),
        ("smacv2_5_units", 5, 5),
        ("smacv2_10_units", 10, 10),
        ("smacv2_20_units", 20, 20),
        ("3-8sz", 8, 8),
        ("3-8sz+1", 8, 9),
    ] {
        assert_eq!(count(set), [allies, enemies], "{set}");
    }
    let teams = |set: &str| Roster::named(set).unwrap().teams;
    assert_eq!(teams("2s3z"), [[[2, 2, 3, 3, 3], [2, 2, 3, 3, 3]]]);
    assert_eq!(teams("3s_vs_5z"), [[vec![STALKER; 3], vec![ZEALOT; 5]]]);
    assert_eq!(teams("6h_vs_8z"), [[vec![5; 6], vec![ZEALOT; 8]]]);
    assert_eq!(teams("1m1M1l"), [[[0, 1, 4], [0, 1, 4]]]);
    for wrong in [
        "",
        "s",
        "2",
        "2x",
        "0m",
        "2m_vs_",
        "33m_vs_32m",
        "smacv2_0_units",
        "smacv2_33_units",
        "3-8m",
    ] {
        assert!(Roster::named(wrong).is_none(), "{wrong}");
    }
    let widest = Roster::named("5m_vs_59m").unwrap();
    assert_eq!(widest.most(), [5, 59]);
    assert_eq!(Roster::named("32m").unwrap().most(), [CAPACITY / 2; 2]);
    assert_eq!(Roster::named("1m_vs_63m").unwrap().most(), [1, 63]);
}

#[test]
fn tasks_are_all_teams_of_three_to_eight() {
    let mut same = Roster::named("3-8sz").unwrap().teams;
    assert_eq!(same.len(), 39);
    assert!(same.iter().all(|[allies, enemies]| allies == enemies && allies.is_sorted()));
    same.sort();
    same.dedup();
    assert_eq!(same.len(), 39);
    let mut harder = Roster::named("3-8sz+1").unwrap().teams;
    for [allies, enemies] in &harder {
        assert_eq!(allies.len() + 1, enemies.len());
        assert!(enemies.is_sorted() && allies.iter().all(|kind| [STALKER, ZEALOT].contains(kind)));
        let more = |kind: u8| {
            let [ours, theirs] =
                [allies, enemies].map(|team| team.iter().filter(|it| **it == kind).count());
            theirs - ours
        };
        assert_eq!(more(STALKER) + more(ZEALOT), 1);
    }
    harder.sort();
    harder.dedup();
    assert_eq!(harder.len(), 78);
}

#[test]
fn fixed_teams_start_near_two_places() {
    let mut random = generator(1);
    let (mut least, mut most) = ([f32::MAX; 4], [f32::MIN; 4]);
    for _ in 0..2000 {
        let battle = Roster::named("5m_vs_6m").unwrap().draw(&mut random);
        assert_eq!(battle.alive(), [5, 6]);
        for (number, unit) in battle.units[..11].iter().enumerate() {
            assert_eq!((unit.health, unit.cooldown, unit.order), (45, 0.0, STOP));
            for (axis, part) in unit.place.into_iter().enumerate() {
                let bounds = axis + 2 * usize::from(number >= 5);
                (least[bounds], most[bounds]) = (least[bounds].min(part), most[bounds].max(part));
            }
        }
    }
    for (bounds, middle) in [8.0, 16.0, 24.0, 16.0].into_iter().enumerate() {
        assert!((middle - 2.0..middle - 1.99).contains(&least[bounds]), "{least:?}");
        assert!((middle + 1.99..middle + 2.0).contains(&most[bounds]), "{most:?}");
    }
}

#[test]
fn drawn_teams_mirror_or_surround_each_other() {
    let (mut random, roster) = (generator(2), Roster::named("smacv2_5_units").unwrap());
    let (mut kinds, mut mirrored, mut inside, mut beyond) = ([0; 6], 0, [0; 2], 0);
    let games = 4000;
    for _ in 0..games {
        let battle = roster.draw(&mut random);
        let (allies, enemies) = battle.units[..10].split_at(5);
        for (ally, enemy) in allies.iter().zip(enemies) {
            assert_eq!(ally.kind, enemy.kind);
            kinds[ally.kind()] += 1;
        }
        let is_mirror = allies.iter().zip(enemies).all(|(ally, enemy)| {
            let ([x, y], [other_x, other_y]) = (ally.place, enemy.place);
            (0.0..16.0).contains(&x) && other_x == 32.0 - x && other_y == y
        });
        mirrored += usize::from(is_mirror);
        let is_middle = |team: &[_]| {
            team.iter().all(|unit: &Unit| unit.place.iter().all(|part| (14.0..18.0).contains(part)))
        };
        if !is_mirror {
            assert!(is_middle(allies) || is_middle(enemies));
            inside[usize::from(is_middle(enemies))] += 1;
            let is_far = |part: &f32| !(0.0..=32.0).contains(part);
            beyond += usize::from(battle.units[..10].iter().any(|it| it.place.iter().any(is_far)));
            assert!(
                battle
                    .units
                    .iter()
                    .all(|it| it.place.iter().all(|part| (-2.0..34.0).contains(part)))
            );
        }
    }
    assert!((1900..2100).contains(&mirrored), "{mirrored}");
    assert!(inside.iter().all(|count| (900..1100).contains(count)), "{inside:?}");
    assert!(kinds.iter().all(|count| (3150..3520).contains(count)), "{kinds:?}");
    // The rule book counted 10 in 100 episodes.
    assert!((320..480).contains(&beyond), "{beyond}");
}

#[test]
fn ranges_and_sights_do_not_include_their_ends() {
    for (kind, range, sight) in (0_u8..).zip(RANGE).zip(SIGHT).map(|((a, b), c)| (a, b, c)) {
        for (way, is_near) in [(range, false), (range - 1e-3, true)] {
            let near = battle(&[(kind, [4.0, 8.0])], &[(MARINE, [4.0 + way, 8.0])]);
            assert_eq!(near.available(0) >> ATTACK & 1 == 1, is_near, "type {kind} at {way}");
            let mut near = near;
            near.units[0].order = ATTACK;
            let mut shots = 0;
            near.fight(&Rules::default(), |tick, shot| {
                assert_eq!(shot, [0, 1]);
                shots += usize::from(tick == 0);
                0.0
            });
            assert_eq!(shots == 1, is_near, "type {kind} at {way}");
        }
        for (way, is_seen) in [(sight, false), (sight - 1e-3, true)] {
            let far = battle(&[(kind, [4.0, 8.0])], &[(MARINE, [4.0 + way, 8.0])]);
            assert_eq!(far.sees(0, 1), is_seen, "type {kind} at {way}");
        }
    }
}

#[test]
fn weapons_wait_for_their_period_and_no_longer() {
    let mut duel = battle(&[(STALKER, [13.0, 16.0])], &[(STALKER, [18.9, 16.0])]);
    let (mut random, mut shots) = (generator(3), [const { Vec::new() }; 2]);
    let mut tick_of = 0;
    while !duel.is_over(&Rules::default()) {
        duel.units[..2].iter_mut().for_each(|unit| unit.order = ATTACK);
        duel.fight(&Rules::default(), |tick, [unit, _]| {
            shots[unit].push(tick_of + tick);
            jitter(&mut random)
        });
        tick_of += 8;
    }
    let loser = usize::from(duel.units[1].health == 0);
    assert_eq!(shots[1 - loser].len(), 13);
    for pair in shots.iter().flat_map(|shots| shots.windows(2)) {
        assert!((30..=33).contains(&(pair[1] - pair[0])), "{shots:?}");
    }
    // A weapon is ready at zero, and sinks on while it is idle.
    let mut waits = battle(&[(MARINE, [13.0, 16.0])], &[(MARINE, [14.0, 16.0])]);
    (waits.units[0].cooldown, waits.units[0].order) = (2.0 * TICK, ATTACK);
    let mut first = Vec::new();
    waits.fight(&Rules::default(), |tick, _| {
        first.push(tick);
        0.0
    });
    assert_eq!((first, waits.units[1].cooldown), (vec![2], -0.5));
    assert_eq!(waits.units[0].cooldown, 0.61 - 5.0 * TICK);
}

#[test]
fn cooldowns_differ_from_a_tick_less_to_two_more() {
    let mut random = generator(4);
    let drawn: Vec<f32> = (0..10_000).map(|_| jitter(&mut random)).collect();
    let (least, most) = (
        drawn.iter().fold(1.0, |a: f32, b| a.min(*b)),
        drawn.iter().fold(0.0, |a: f32, b| a.max(*b)),
    );
    let mean = drawn.iter().sum::<f32>() / 10_000.0;
    assert!((-TICK..-0.99 * TICK).contains(&least) && (1.99 * TICK..2.0 * TICK).contains(&most));
    assert!((mean - 0.5 * TICK).abs() < 0.02 * TICK, "{mean}");
}

#[test]
fn all_is_at_once_and_what_is_too_much_is_lost() {
    let mut both = battle(&[(MARINE, [13.0, 16.0]); 2], &[(MARINE, [14.0, 16.0])]);
    both.units[1].place[1] = 17.0;
    both.units[..3].iter_mut().for_each(|unit| (unit.order, unit.health) = (ATTACK, 9));
    both.units[1].health = 45;
    let reward = both.fight(&Rules::default(), |_, _| 0.0);
    // The enemy's first foe is the last ally.
    assert_eq!([0, 1, 2].map(|unit| both.units[unit].health), [9, 36, 0]);
    assert_eq!(reward, 9.0 / 45.0 + 1.0);
    let mut draw = battle(&[(MARINE, [13.0, 16.0])], &[(MARINE, [14.0, 16.0])]);
    draw.units[..2].iter_mut().for_each(|unit| (unit.order, unit.health) = (ATTACK, 5));
    let reward = draw.fight(&Rules::default(), |_, _| 0.0);
    assert_eq!((draw.alive(), reward, draw.is_over(&Rules::default())), ([0, 0], 5.0 / 45.0, true));
}

#[test]
fn walls_kill_and_their_victims_are_paid_for() {
    let start = || {
        let mut battle = battle(&[(MARINE, [13.0, 16.0])], &[(STALKER, [31.5, 16.0])]);
        battle.units[1].order = EAST;
        battle
    };
    let mut killed = start();
    assert_eq!(killed.fight(&Rules::default(), |_, _| 0.0), 2.0);
    assert_eq!((killed.alive(), killed.units[1].place), ([1, 0], [32.0, 16.0]));
    let soft = Rules { walls_cause_death: false, ..Rules::default() };
    let mut alive = start();
    assert_eq!((alive.fight(&soft, |_, _| 0.0), alive.alive()), (0.0, [1, 1]));
    let alone = Rules { self_play_reward: true, ..Rules::default() };
    assert_eq!(start().fight(&alone, |_, _| 0.0), 1.0);
    let mut lost = battle(&[(MARINE, [0.2, 16.0])], &[(STALKER, [24.0, 16.0])]);
    lost.units[0].order = WEST;
    assert_eq!(lost.fight(&alone, |_, _| 0.0), -1.0);
}

#[test]
fn the_dead_of_classic_rules_walk_and_push() {
    let start = || {
        let mut battle =
            battle(&[(MARINE, [13.0, 16.0]), (MARINE, [20.0, 5.0])], &[(MARINE, [13.5, 16.0])]);
        (battle.units[2].health, battle.units[2].order) = (0, NORTH);
        battle
    };
    let mut current = start();
    current.fight(&Rules::default(), |_, _| 0.0);
    assert_eq!([0, 2].map(|unit| current.units[unit].place), [[13.0, 16.0], [13.5, 16.0]]);
    let classic = Rules { rules: RuleBook::Classic, ..Rules::default() };
    let mut old = start();
    old.fight(&classic, |_, _| 0.0);
    assert!(old.units[0].place[0] < 13.0 && old.units[2].place[1] > 17.0);
    // It walks as if it stood in the corner, and sees nobody.
    let mut dead = start();
    (dead.steps, dead.units[2].goal, dead.units[2].target) = (1, [18.0, 16.0], 0);
    let dead = commanded(&dead, &classic);
    assert_eq!((dead.units[2].order, dead.units[2].target), (EAST, NOBODY));
}

#[test]
fn enemies_keep_their_target_and_else_take_the_nearest() {
    let rules = &Rules::default();
    let mut seen = battle(
        &[(MARINE, [11.0, 16.0]), (MARINE, [14.0, 13.0]), (MARINE, [16.9, 16.0])],
        &[(MARINE, [14.0, 16.0])],
    );
    // An enemy counts backwards.
    assert_eq!(orders(&commanded(&seen, rules)), [ATTACK]);
    seen.units[2].place = [17.0, 16.0];
    // Of three as near as each other it takes the last.
    assert_eq!(orders(&commanded(&seen, rules)), [ATTACK]);
    seen.units[2].place = [17.1, 16.0];
    assert_eq!(orders(&commanded(&seen, rules)), [ATTACK + 1]);
    seen.units[3].target = 2;
    let kept = commanded(&seen, rules);
    assert_eq!((orders(&kept), kept.units[3].target), (vec![ATTACK], 2));
    // Out of reach it is forgotten at once, as whoever died is.
    seen.units[2].place = [19.1, 16.0];
    let next = commanded(&seen, rules);
    assert_eq!((orders(&next), next.units[3].target), (vec![ATTACK + 1], 1));
    (seen.units[2].place, seen.units[2].health) = ([14.0, 17.0], 0);
    assert_eq!(commanded(&seen, rules).units[3].target, 1);
    // By chance among those within reach.
    let random = Rules { attack_mode: AttackMode::Random, ..Rules::default() };
    let mut drawn = seen.clone();
    drawn.units[3].target = NOBODY;
    drawn.command(&random, |enemy, among| {
        assert_eq!((enemy, among), (3, 0b011));
        0
    });
    assert_eq!((orders(&drawn), drawn.units[3].target), (vec![ATTACK + 2], 0));
}

#[test]
fn enemies_go_to_whom_they_see_and_else_to_where_they_came_from_in_a_mirror() {
    let rules = &Rules::default();
    let mut far =
        battle(&[(MARINE, [8.0, 16.0]), (MARINE, [8.0, 17.0])], &[(STALKER, [24.0, 10.0])]);
    let lone = commanded(&far, rules);
    assert_eq!((lone.units[2].goal, lone.units[2].order), ([8.0, 22.0], WEST));
    // Later it is not told anew. Of two ways as good as each other the first is taken.
    (far.steps, far.units[2].goal) = (1, [20.0, 14.0]);
    assert_eq!(orders(&commanded(&far, rules)), [NORTH]);
    (far.units[2].goal, far.units[2].place) = ([24.0, 10.0], [24.0, 10.0]);
    assert_eq!(orders(&commanded(&far, rules)), [NORTH]);
    far.units[2].goal = [23.0, 9.0];
    assert_eq!(orders(&commanded(&far, rules)), [SOUTH]);
    (far.units[0].place, far.units[1].place) = ([24.0, 17.0], [31.0, 10.0]);
    for (ally, order) in [(0, NORTH), (1, EAST)] {
        let mut drawn = far.clone();
        drawn.command(rules, |enemy, among| {
            assert_eq!((enemy, among), (2, 0b11));
            ally
        });
        assert_eq!(orders(&drawn), [order]);
    }
    // Who may not shoot walks to whom it would shoot at, and remembers it.
    far.units[0].place = [24.0, 12.0];
    let peace = Rules { enemy_shoots: false, ..Rules::default() };
    far.command(&peace, |_, _| 0);
    assert_eq!((orders(&far), far.units[2].target), (vec![NORTH], 0));
}

/// Plays episodes in which all agents take one action as long as they may, and returns their steps, return and whether
/// they timed out.
fn played(world: &mut dyn Environment, action: u16, random: &mut Random) -> (u32, f64, bool) {
    world.reset(0, random);
    let mut seen = crate::Observation::default();
    loop {
        world.observe(&saved(world), 0, 0, &mut seen);
        let choose =
            |available: &u128| if available >> action & 1 == 1 { action } else { STOP.into() };
        let actions: Vec<u16> = seen.available.iter().map(choose).collect();
        if world.step(0, &actions, random).unwrap().done() {
            let episode = world.episode(0);
            assert!(!(episode.timed_out && episode.solved));
            return (episode.steps, episode.episode_return, episode.timed_out);
        }
    }
}

#[test]
fn time_runs_out_after_a_hundred_and_one_steps() {
    let peace = Rules { enemy_shoots: false, ..Rules::default() };
    assert_eq!(played(&mut smax("3m", peace.clone()), 4, &mut generator(1)), (101, 0.0, true));
    let short = Rules { max_steps: 0, ..peace.clone() };
    assert_eq!(played(&mut smax("3m", short), 4, &mut generator(1)), (1, 0.0, true));
    for seed in 0..20 {
        let (steps, earned, timed_out) =
            played(&mut smax("3m", peace.clone()), 3, &mut generator(seed));
        assert!((4..=7).contains(&steps) && !timed_out, "{steps}");
        assert_eq!(earned, 0.0);
    }
}

#[test]
fn units_that_start_too_near_are_pushed_apart() {
    let mut world = smax("25m", Rules::default());
    let mut start = world.roster.draw(&mut generator(8));
    let drawn = start.clone();
    start.push_apart(&world.rules);
    world.reset(0, &mut generator(8));
    assert_eq!(world.battles[0].units, start.units);
    assert!(start.units != drawn.units);
}

#[test]
fn a_draw_in_the_last_step_is_neither_won_nor_timed_out() {
    let mut world = smax("1m", Rules::default());
    let mut draw = battle(&[(MARINE, [13.0, 16.0])], &[(MARINE, [14.0, 16.0])]);
    draw.steps = 100;
    draw.units[..2].iter_mut().for_each(|unit| unit.health = 9);
    world.battles[0] = draw;
    let step = world.step(0, &[ATTACK.into()], &mut generator(1)).unwrap();
    assert!(step.terminated && !step.timed_out);
    let episode = world.episode(0);
    assert!(episode.done && !episode.solved && !episode.timed_out);
    assert_eq!((episode.steps, episode.metrics), (101, vec![Some(1.0), Some(0.0)]));
}

#[test]
fn a_won_battle_returns_two() {
    let (mut world, mut random) = (smax("2s3z", Rules::default()), generator(5));
    let (mut won, mut actions) = (0, [0; 5]);
    for _ in 0..100 {
        world.reset(0, &mut random);
        while !world.episode(0).done {
            let state = saved(&world);
            assert!(world.scripted(&state, &[], &mut generator(0), &mut actions));
            world.step(0, &actions, &mut random).unwrap();
        }
        let episode = world.episode(0);
        won += usize::from(episode.solved);
        let is_two = (episode.episode_return - 2.0).abs() < 1e-5;
        assert_eq!(episode.solved, is_two, "{}", episode.episode_return);
        assert_eq!(episode.solved, episode.metrics[0] == Some(5.0));
    }
    // The rule book's script of the same kind wins 0.83.
    assert!((72..=94).contains(&won), "{won}");
}

#[test]
fn random_play_earns_what_the_reference_earns() {
    for (set, want, error) in [("2s3z", 0.205, 0.015), ("smacv2_5_units", 0.255, 0.03)] {
        let (mut world, mut random) = (smax(set, Rules::default()), generator(6));
        world.reset(0, &mut random);
        let (rounds, mut episodes) = (20_000, 0.0);
        let earned = observe_and_step(&mut world, &mut random, rounds);
        // Episodes are 54 and 36 steps long there.
        episodes += rounds as f64 / if set == "2s3z" { 53.7 } else { 36.1 };
        let mean = earned / episodes;
        assert!((mean - want).abs() < error, "{set}: {mean} for an episode");
    }
}
