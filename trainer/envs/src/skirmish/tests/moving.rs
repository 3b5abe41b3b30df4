//! Walking, and those in the way.

use super::super::battle::{Battle, Order};
use super::super::units::{Book, COLOSSUS, MARINE, MEDIVAC, STALKER, ZEALOT};
use super::{battle, liberty, order, ticks, until};

/// Somebody far off, so that a battle is one.
const NOBODY_NEAR: [(u8, [f32; 2]); 1] = [(MARINE, [31.0, 31.0])];

#[test]
fn units_walk_at_their_speed_and_arrive_exactly() {
    let book = liberty();
    let mut battle = battle(&book, &[(MARINE, [5.0; 2]), (STALKER, [5.0, 9.0])], &NOBODY_NEAR);
    order(&mut battle, &[(0, Order::Go([7.0, 5.0])), (1, Order::Go([5.0, 11.0]))]);
    ticks(&book, &mut battle, 8);
    assert!((battle.units[0].place[0] - 6.125).abs() < 1e-5);
    assert!((battle.units[1].place[1] - (9.0 + 2.9531 / 2.0)).abs() < 1e-5);
    ticks(&book, &mut battle, 8);
    assert_eq!(battle.units[0].place, [7.0, 5.0]);
    assert_eq!(battle.units[1].place, [5.0, 11.0]);
    assert_eq!([battle.units[0].blocked, battle.units[1].blocked], [0, 0]);
}

#[test]
fn a_medivac_gathers_speed_and_others_do_not() {
    let book = liberty();
    let mut battle = battle(&book, &[(MEDIVAC, [5.0; 2])], &NOBODY_NEAR);
    order(&mut battle, &[(0, Order::Go([25.0, 5.0]))]);
    ticks(&book, &mut battle, 1);
    let gain = 2.3125 / 256.0;
    assert!((battle.units[0].place[0] - 5.0 - gain).abs() < 1e-5);
    ticks(&book, &mut battle, 40);
    let before = battle.units[0].place[0];
    ticks(&book, &mut battle, 1);
    assert!((battle.units[0].place[0] - before - 0.171875).abs() < 1e-4);
    order(&mut battle, &[(0, Order::Stop)]);
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[0].speed, 0.0);
}

#[test]
fn nobody_leaves_the_map() {
    let book = liberty();
    let mut battle = battle(&book, &[(MARINE, [0.5, 31.8])], &NOBODY_NEAR);
    order(&mut battle, &[(0, Order::Go([-2.0, 34.0]))]);
    ticks(&book, &mut battle, 40);
    assert_eq!(battle.units[0].place, [0.0, 32.0]);
}

#[test]
fn who_walks_goes_around_who_stands() {
    let book = liberty();
    let mut battle = battle(&book, &[(ZEALOT, [10.0; 2])], &[(ZEALOT, [13.0, 10.0])]);
    order(&mut battle, &[(0, Order::Go([16.0, 10.0]))]);
    let mut aside = 0.0_f32;
    let there = until(&book, &mut battle, |battle| battle.units[0].place == [16.0, 10.0]);
    assert!(there < 60, "{there}");
    battle.units[0].place = [10.0; 2];
    for _ in 0..60 {
        let (before, far) = (aside, battle.distance(0, 1));
        ticks(&book, &mut battle, 1);
        assert!(battle.distance(0, 1) > 0.74, "{}", battle.distance(0, 1));
        let turns = before == 0.0 && battle.units[0].place[1] != 10.0;
        assert!(!turns || (0.85..1.0).contains(&far), "{far}");
        aside = aside.max((battle.units[0].place[1] - 10.0).abs());
    }
    // A foe does not make way.
    assert_eq!(battle.units[1].place, [13.0, 10.0]);
    assert!((0.5..1.2).contains(&aside), "{aside}");
}

#[test]
fn who_is_blocked_tries_the_other_side() {
    let book = liberty();
    let mut battle = battle(&book, &[(ZEALOT, [0.0, 10.0])], &NOBODY_NEAR);
    order(&mut battle, &[(0, Order::Go([-2.0, 10.0]))]);
    let sides = (0..17).map(|_| {
        ticks(&book, &mut battle, 1);
        battle.units[0].passes_left
    });
    let changes = [&[false; 7][..], &[true; 8], &[false; 2]].concat();
    assert_eq!(sides.collect::<Vec<_>>(), changes);
    assert_eq!(battle.units[0].blocked, 17);
    order(&mut battle, &[(0, Order::Go([2.0, 10.0]))]);
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[0].blocked, 0);
}

/// The side that a zealot passes another one on, which stands exactly in its way.
fn passes(passes_left: bool, smaclite: bool) -> f32 {
    let book = if smaclite { Book::smaclite() } else { liberty() };
    let mut battle = battle(&book, &[(ZEALOT, [10.0; 2])], &[(ZEALOT, [13.0, 10.0])]);
    battle.units[0].passes_left = passes_left;
    order(&mut battle, &[(0, Order::Go([16.0, 10.0]))]);
    until(&book, &mut battle, |battle| battle.units[0].place[0] > 13.0);
    battle.units[0].place[1] - 10.0
}

#[test]
fn everybody_passes_on_its_own_side() {
    for smaclite in [false, true] {
        let [left, right] = [true, false].map(|left| passes(left, smaclite));
        assert!(left > 0.5 && right < -0.5, "{left} {right}");
    }
}

#[test]
fn layers_do_not_meet() {
    let book = liberty();
    let allies = [(MEDIVAC, [10.0, 5.0]), (COLOSSUS, [10.0, 10.0]), (ZEALOT, [10.0, 15.0])];
    let enemies = [(ZEALOT, [13.0, 5.0]), (ZEALOT, [13.0, 10.0]), (MEDIVAC, [13.0, 15.0])];
    let mut battle = battle(&book, &allies, &enemies);
    let goals = [0, 1, 2].map(|unit| (unit, Order::Go([18.0, battle.units[unit].place[1]])));
    order(&mut battle, &goals);
    let straight = [5.0, 10.0, 15.0, 5.0, 10.0, 15.0];
    for _ in 0..60 {
        ticks(&book, &mut battle, 1);
        let north: Vec<f32> = battle.units[..6].iter().map(|unit| unit.place[1]).collect();
        assert_eq!(north, straight);
    }
}

/// SMAClite's colossus is on the ground as all are.
#[test]
fn those_in_the_air_push_each_other_and_do_not_go_around() {
    let book = liberty();
    let allies = [(MEDIVAC, [10.0; 2]), (MEDIVAC, [13.0, 10.0])];
    let mut battle = battle(&book, &allies, &NOBODY_NEAR);
    order(&mut battle, &[(0, Order::Go([20.0, 10.0]))]);
    ticks(&book, &mut battle, 90);
    assert_eq!(battle.units[0].place[1], 10.0);
    assert!(battle.units[1].place[0] > 13.2, "{}", battle.units[1].place[0]);
    let pair = [(COLOSSUS, [10.0, 10.0]), (ZEALOT, [11.0, 10.0])];
    let apart = |book: &Book| apart(book, pair, [Order::Stop, Order::Stop]);
    assert_eq!(apart(&book), [10.0, 11.0]);
    assert!(apart(&Book::smaclite())[0] < 9.9);
}

#[test]
fn nobody_goes_around_its_own_target() {
    let book = liberty();
    // The gap is 0.115, and the range 0.1.
    let mut battle = battle(&book, &[(ZEALOT, [10.0; 2])], &[(MARINE, [10.99, 10.0])]);
    order(&mut battle, &[(0, Order::Attack(1))]);
    ticks(&book, &mut battle, 2);
    assert!(battle.units[1].life < 45.0);
}

#[test]
fn two_in_the_way_are_gone_around_at_once() {
    let book = liberty();
    // It would turn south along the first, where the second stands.
    let enemies = [(ZEALOT, [10.76, 10.1]), (ZEALOT, [10.3, 9.3])];
    let mut battle = battle(&book, &[(ZEALOT, [10.0; 2])], &enemies);
    order(&mut battle, &[(0, Order::Go([16.0, 10.0]))]);
    ticks(&book, &mut battle, 1);
    let [x, y] = battle.units[0].place;
    assert!(y > 10.1 && battle.distance(0, 2) > 0.85, "{x} {y}");
}

#[test]
fn a_push_is_passed_on() {
    let book = liberty();
    let team = [(ZEALOT, [10.0, 10.0]), (ZEALOT, [10.55, 10.0]), (ZEALOT, [11.3, 10.0])];
    let mut battle = battle(&book, &team, &NOBODY_NEAR);
    ticks(&book, &mut battle, 1);
    assert!(battle.units[2].place[0] > 11.34, "{}", battle.units[2].place[0]);
}

/// Places after a tick of two that overlap by 0.2.
fn apart(book: &Book, pair: [(u8, [f32; 2]); 2], orders: [Order; 2]) -> [f32; 2] {
    let mut battle = battle(book, &[pair[0]], &[pair[1]]);
    order(&mut battle, &[(0, orders[0]), (1, orders[1])]);
    ticks(book, &mut battle, 1);
    [0, 1].map(|unit: usize| battle.units[unit].place[0])
}

#[test]
fn who_overlaps_is_pushed_apart_and_who_attacks_stands() {
    let book = liberty();
    let pair = [(ZEALOT, [10.0, 10.0]), (ZEALOT, [10.65, 10.0])];
    let [one, other] = apart(&book, pair, [Order::Stop, Order::Stop]);
    assert!((one - 9.95).abs() < 1e-5 && (other - 10.7).abs() < 1e-5, "{one} {other}");
    // Who walks is moved alone, and who attacks stays.
    let [one, other] = apart(&book, pair, [Order::Go([10.3, 10.0]), Order::Attack(0)]);
    assert!(one < 9.95 && other == 10.65, "{one} {other}");
    // Those in the air give way slowly.
    let pair = [(MEDIVAC, [10.0, 10.0]), (MEDIVAC, [11.4, 10.0])];
    let [one, other] = apart(&book, pair, [Order::Stop, Order::Stop]);
    assert!(other - one < 1.45 && other - one > 1.42, "{one} {other}");
}

#[test]
fn nobody_is_pushed_faster_than_it_walks() {
    let book = liberty();
    let team = [(ZEALOT, [10.0, 10.0]), (ZEALOT, [10.1, 10.0]), (ZEALOT, [10.0, 10.1])];
    let mut battle = battle(&book, &team, &NOBODY_NEAR);
    let before: Vec<_> = battle.units.iter().map(|unit| unit.place).collect();
    ticks(&book, &mut battle, 1);
    for (unit, [x, y]) in battle.units[..3].iter().zip(&before) {
        let came = ((unit.place[0] - x).powi(2) + (unit.place[1] - y).powi(2)).sqrt();
        assert!(came > 0.05 && came < 0.1407, "{came}");
    }
    let overlaps = |battle: &Battle| {
        [(0, 1), (0, 2), (1, 2)].iter().all(|(one, other)| battle.distance(*one, *other) > 0.74)
    };
    assert!(until(&book, &mut battle, overlaps) < 30);
}

#[test]
fn the_dead_are_no_obstacle() {
    let book = liberty();
    let mut battle = battle(&book, &[(ZEALOT, [10.0; 2])], &[(ZEALOT, [13.0, 10.0])]);
    battle.units[1].life = 0.0;
    order(&mut battle, &[(0, Order::Go([16.0, 10.0]))]);
    for _ in 0..50 {
        ticks(&book, &mut battle, 1);
        assert_eq!(battle.units[0].place[1], 10.0);
    }
    assert_eq!((battle.units[0].place[0], battle.units[1].place), (16.0, [13.0, 10.0]));
}
