//! What enemies do by themselves.

use super::super::battle::{Battle, NOBODY, Order};
use super::super::units::{Book, MARAUDER, MARINE, MEDIVAC, STALKER, ZEALOT};
use super::{Placed, battle, liberty, order, ticks, until};

/// Allies that stand, and enemies that advance to a point.
fn advance(book: &Book, allies: &[Placed], enemies: &[Placed], point: [f32; 2]) -> Battle {
    let mut battle = battle(book, allies, enemies);
    for enemy in battle.side(false) {
        battle.units[enemy].order = Order::Advance(point);
    }
    battle
}

/// Whom the only enemy, at (10, 10), is after in the first tick.
fn target(kind: u8, allies: &[Placed]) -> Option<usize> {
    let book = liberty();
    let mut battle = advance(&book, allies, &[(kind, [10.0; 2])], [30.0, 10.0]);
    ticks(&book, &mut battle, 1);
    let target = battle.units[allies.len()].target;
    (target != NOBODY).then(|| target.into())
}

#[test]
fn the_nearest_that_is_seen_and_can_be_hit_is_attacked() {
    // From 5 on, or from the range on where that is longer, between edges.
    let zealot_at = |x: f32| [(ZEALOT, [x, 10.0])];
    assert_eq!(target(ZEALOT, &zealot_at(15.9)), Some(0));
    assert_eq!(target(ZEALOT, &zealot_at(16.1)), None);
    assert_eq!(target(STALKER, &zealot_at(17.1)), Some(0));
    assert_eq!(target(STALKER, &zealot_at(17.2)), None);
    // By the gap between edges: the marine's centre is nearer, its edge is not.
    assert_eq!(target(STALKER, &[(MARINE, [13.0, 10.0]), (STALKER, [13.2, 10.0])]), Some(1));
    assert_eq!(target(STALKER, &[(MARINE, [13.0, 10.0]), (MARINE, [7.0, 10.0])]), Some(0));
    // A medivac is nobody special, and no target of zealots.
    assert_eq!(target(STALKER, &[(MARINE, [12.0, 10.0]), (MEDIVAC, [13.0, 10.0])]), Some(0));
    assert_eq!(target(STALKER, &[(MARINE, [15.0, 10.0]), (MEDIVAC, [13.0, 10.0])]), Some(1));
    assert_eq!(target(ZEALOT, &[(MARINE, [15.0, 10.0]), (MEDIVAC, [13.0, 10.0])]), Some(0));
}

#[test]
fn a_target_is_kept_while_it_is_about_in_range() {
    let book = liberty();
    let allies = [(ZEALOT, [16.5, 10.0]), (ZEALOT, [10.0, 25.0])];
    let mut battle = advance(&book, &allies, &[(STALKER, [10.0; 2])], [30.0, 10.0]);
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[2].target, 0);
    battle.units[1].place = [10.0, 13.0];
    battle.units[0].place = [18.0, 10.0];
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[2].target, 0);
    // The range of 6 and 1 more end at 8.125.
    battle.units[0].place = [18.5, 10.0];
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[2].target, 1);
}

#[test]
fn enemies_advance_to_a_point_and_wait_there() {
    let book = liberty();
    let mut battle = advance(&book, &[(MARINE, [30.0; 2])], &[(ZEALOT, [10.0; 2])], [14.0, 10.0]);
    ticks(&book, &mut battle, 80);
    let [x, y] = battle.units[1].place;
    assert!((13.0..13.15).contains(&x) && y == 10.0, "{x}");
    // Who comes near is attacked nevertheless.
    battle.units[0].place = [16.0, 10.0];
    until(&book, &mut battle, |battle| battle.units[0].life < 45.0);
}

#[test]
fn who_is_hurt_goes_for_the_attacker_and_so_do_comrades_that_hear_it() {
    let book = liberty();
    let enemies = [(ZEALOT, [10.0; 2]), (ZEALOT, [10.0, 13.9]), (ZEALOT, [10.0, 14.5])];
    let mut battle = advance(&book, &[(MARAUDER, [20.0, 10.0])], &enemies, [10.0, 30.0]);
    (1..4).for_each(|enemy| battle.units[enemy].order = Order::Stop);
    battle.units[0].place = [16.9, 10.0];
    order(&mut battle, &[(0, Order::Attack(1))]);
    until(&book, &mut battle, |battle| battle.units[1].shield < 50.0);
    // Out of sight, so that memory alone is left.
    battle.units[0].place = [20.0, 10.0];
    order(&mut battle, &[(0, Order::Stop)]);
    (1..4).for_each(|enemy| battle.units[enemy].order = Order::Advance([10.0, 30.0]));
    ticks(&book, &mut battle, 1);
    let targets = [1, 2, 3].map(|enemy: usize| battle.units[enemy].target);
    assert_eq!(targets, [0, 0, NOBODY]);
    // It is forgotten after 32 ticks.
    battle.units[0].place = [30.0, 2.0];
    ticks(&book, &mut battle, 30);
    assert_eq!(battle.units[1].target, 0);
    ticks(&book, &mut battle, 1);
    assert_eq!([battle.units[1].target, battle.units[1].attacker], [NOBODY; 2]);
}

#[test]
fn who_can_not_be_hit_is_not_gone_for() {
    let book = liberty();
    let allies = [(MARINE, [25.0, 10.0]), (MEDIVAC, [20.0, 10.0])];
    let mut battle = advance(&book, &allies, &[(ZEALOT, [10.0; 2])], [10.0, 30.0]);
    (battle.units[2].attacker, battle.units[2].alarm) = (1, 20);
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[2].target, NOBODY);
    battle.units[2].attacker = 0;
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[2].target, 0);
}

#[test]
fn a_retreat_minds_nobody_until_it_is_over() {
    let book = liberty();
    let mut battle = battle(&book, &[(ZEALOT, [12.0, 10.0])], &[(MARINE, [10.0; 2])]);
    order(&mut battle, &[(1, Order::Go([20.0, 10.0]))]);
    let over = until(&book, &mut battle, |battle| battle.units[1].order != Order::Go([20.0, 10.0]));
    assert!(over > 55, "{over}");
    assert_eq!((battle.units[0].shield, battle.units[1].target), (50.0, NOBODY));
    let place = battle.units[1].place;
    assert!((18.8..19.0).contains(&place[0]), "{place:?}");
    // On guard there: it shoots, and stays.
    battle.units[0].place = [21.0, 10.0];
    until(&book, &mut battle, |battle| battle.units[0].shield < 50.0);
    assert_eq!(battle.units[1].place, place);
}

#[test]
fn a_retreat_that_is_blocked_is_over() {
    let book = liberty();
    let mut battle = battle(&book, &[(ZEALOT, [30.0; 2])], &[(MARINE, [0.0, 10.0])]);
    order(&mut battle, &[(1, Order::Go([-5.0, 10.0]))]);
    let over = until(&book, &mut battle, |battle| battle.units[1].blocked == 16);
    assert_eq!(over, 16);
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[1].order, Order::Advance([0.0, 10.0]));
}

#[test]
fn a_medivac_tends_whom_it_sees_in_the_worst_state() {
    let book = liberty();
    let team = [(MEDIVAC, [10.0; 2]), (MARINE, [12.0, 10.0]), (MARAUDER, [10.0, 12.0])];
    let mut battle = advance(&book, &[(MARINE, [31.0; 2])], &team, [10.0; 2]);
    let tended = |battle: &mut Battle| {
        ticks(&book, battle, 1);
        battle.units[1].target
    };
    assert_eq!(tended(&mut battle), NOBODY);
    battle.units[2].life = 40.0;
    battle.units[3].life = 60.0;
    assert_eq!(tended(&mut battle), 3);
    // It stays with a patient within range, and takes the worst of those that it sees otherwise.
    battle.units[2].life = 5.0;
    assert_eq!(tended(&mut battle), 3);
    battle.units[3].place = [10.0, 17.0];
    assert_eq!(tended(&mut battle), 2);
    // A new patient takes energy.
    battle.units[1].target = NOBODY;
    battle.units[1].energy = 4.0;
    assert_eq!(tended(&mut battle), NOBODY);
    battle.units[1].energy = 5.0;
    assert_eq!(tended(&mut battle), 2);
    // Nobody farther than 6 between edges.
    battle.units[2].place = [10.0, 17.2];
    battle.units[3].life = 125.0;
    assert_eq!(tended(&mut battle), NOBODY);
}

/// In the manner of SMAClite: whom the only enemy, at (10, 10), is after.
fn urgent(kind: u8, allies: &[Placed], prepare: impl Fn(&mut Battle)) -> u8 {
    let book = Book::smaclite();
    let mut battle = advance(&book, allies, &[(kind, [10.0; 2])], [30.0, 10.0]);
    prepare(&mut battle);
    ticks(&book, &mut battle, 1);
    battle.units[allies.len()].target
}

#[test]
fn healers_are_attacked_first_in_the_manner_of_smaclite() {
    let near = [(MARINE, [12.0, 10.0]), (MEDIVAC, [15.0, 10.0])];
    assert_eq!(urgent(MARINE, &near, |_| {}), 1);
    assert_eq!(urgent(ZEALOT, &near, |_| {}), 0);
    // Also by who is after somebody else already.
    assert_eq!(urgent(MARINE, &near, |battle| battle.units[2].target = 0), 1);
    // Seen from 5 and the target's radius on, between centres; who is after it, from anywhere.
    assert_eq!(urgent(STALKER, &[(ZEALOT, [15.4, 10.0])], |_| {}), 0);
    let far = [(ZEALOT, [15.6, 10.0])];
    assert_eq!(urgent(STALKER, &far, |_| {}), NOBODY);
    assert_eq!(urgent(STALKER, &far, |battle| battle.units[0].order = Order::Attack(1)), 0);
}
