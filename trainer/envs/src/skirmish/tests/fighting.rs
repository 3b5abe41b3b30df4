//! Shots, wounds, deaths and healing.

use super::super::battle::{Battle, NOBODY, Order};
use super::super::units::{
    Book, COLOSSUS, MARAUDER, MARINE, MEDIVAC, STALKER, UnitType, Weapon, ZEALOT,
};
use super::{battle, liberty, order, ticks, until};
use crate::random::generator;

/// An ally shoots at an enemy beside it, which is prepared before.
fn duel(shooter: u8, victim: u8, prepare: impl Fn(&mut Battle)) -> (Book, Battle) {
    let book = liberty();
    let mut battle = battle(&book, &[(shooter, [16.0; 2])], &[(victim, [17.4, 16.0])]);
    order(&mut battle, &[(0, Order::Attack(1))]);
    prepare(&mut battle);
    (book, battle)
}

/// Life and shield that a victim has left after the first shot.
fn after_a_shot(shooter: u8, victim: u8, life: f32, shield: f32) -> [f32; 2] {
    let (book, mut battle) = duel(shooter, victim, |battle| {
        let unit = &mut battle.units[1];
        (unit.life, unit.shield, unit.unhurt) = (life, shield, 50);
    });
    until(&book, &mut battle, |battle| battle.units[1].unhurt == 1);
    [battle.units[1].life, battle.units[1].shield]
}

#[test]
fn a_hit_takes_shields_first_and_armor_softens_the_rest() {
    for (shooter, victim, before, after) in [
        // Shields have no armor.
        (MARINE, ZEALOT, [100.0, 50.0], [100.0, 44.0]),
        (MARINE, ZEALOT, [100.0, 4.0], [99.0, 0.0]),
        (MARINE, ZEALOT, [100.0, 0.0], [95.0, 0.0]),
        (MARINE, MARINE, [45.0, 0.0], [39.0, 0.0]),
        // The least damage, though armor is more than what is left; none where shields take it all.
        (MARINE, ZEALOT, [100.0, 5.8], [99.5, 0.0]),
        (MARINE, ZEALOT, [100.0, 6.0], [100.0, 0.0]),
        // The bonus is for the armored alone.
        (MARAUDER, MARINE, [45.0, 0.0], [35.0, 0.0]),
        (MARAUDER, MARAUDER, [125.0, 0.0], [106.0, 0.0]),
        (STALKER, COLOSSUS, [200.0, 150.0], [200.0, 136.0]),
        (STALKER, ZEALOT, [100.0, 0.0], [91.0, 0.0]),
        // One hit of two at first, and two at once, each of which armor softens.
        (ZEALOT, MARAUDER, [125.0, 0.0], [118.0, 0.0]),
        (COLOSSUS, ZEALOT, [100.0, 30.0], [91.0, 0.0]),
    ] {
        let got = after_a_shot(shooter, victim, before[0], before[1]);
        assert!((got[0] - after[0]).abs() < 1e-4, "{shooter} {victim} {before:?}: {got:?}");
        assert!((got[1] - after[1]).abs() < 1e-4, "{shooter} {victim} {before:?}: {got:?}");
    }
}

#[test]
fn a_newer_balance_has_a_bonus_against_the_light_alone() {
    let book = Book::smaclite();
    let damage = |shooter: u8, victim: u8| {
        let mut battle = battle(&book, &[(shooter, [16.0; 2])], &[(victim, [18.0, 16.0])]);
        order(&mut battle, &[(0, Order::Attack(1))]);
        until(&book, &mut battle, |battle| battle.units[1].unhurt < u8::MAX);
        book.types[usize::from(victim)].shield - battle.units[1].shield
    };
    assert_eq!([damage(COLOSSUS, ZEALOT), damage(COLOSSUS, STALKER)], [30.0, 20.0]);
    assert_eq!([damage(STALKER, ZEALOT), damage(STALKER, STALKER)], [13.0, 18.0]);
    let colossus = (COLOSSUS, [10.0; 2]);
    let mut battle = battle(&book, &[colossus], &[(ZEALOT, [18.4, 10.0])]);
    order(&mut battle, &[(0, Order::Attack(1))]);
    ticks(&book, &mut battle, 1);
    assert_eq!(battle.units[1].shield, 20.0, "it shoots as far as 7");
}

/// The tick of the first wound, from an order in range on.
fn first_wound(shooter: u8, victim: u8) -> usize {
    let (book, mut battle) = duel(shooter, victim, |_| {});
    until(&book, &mut battle, |battle| battle.units[1].unhurt < u8::MAX)
}

#[test]
fn shots_are_wound_up_and_fly() {
    // A marine takes aim for a tick, a zealot strikes at once.
    assert_eq!(first_wound(MARINE, ZEALOT), 2);
    assert_eq!(first_wound(ZEALOT, COLOSSUS), 1);
    // Three ticks and a flight of 0.275 at 1.17 in a tick; a flight of 0.3375 at 1.25; one tick and the beam's six.
    assert_eq!(first_wound(STALKER, ZEALOT), 5);
    assert_eq!(first_wound(MARAUDER, ZEALOT), 2);
    assert_eq!(first_wound(COLOSSUS, MARINE), 8);
    let book = liberty();
    let mut far = battle(&book, &[(MARAUDER, [10.0; 2])], &[(MARINE, [16.0, 10.0])]);
    order(&mut far, &[(0, Order::Attack(1))]);
    let wound = until(&book, &mut far, |battle| battle.units[1].unhurt < u8::MAX);
    assert_eq!(wound, 1 + (5.0625_f32 / 1.25).ceil() as usize);
}

#[test]
fn a_shot_follows_another_by_its_period_and_chance() {
    let (book, mut battle) = duel(MARINE, COLOSSUS, |_| {});
    let wounded = |battle: &Battle| battle.units[1].unhurt == 1;
    let times: Vec<usize> = (0..4).map(|_| until(&book, &mut battle, wounded)).collect();
    // 13.77 ticks, of which no fraction is carried over.
    assert_eq!(times, [2, 14, 14, 14]);
    order(&mut battle, &[(0, Order::Stop)]);
    ticks(&book, &mut battle, 20);
    assert_eq!(battle.units[0].cooldown, 0.0);
    let book = Book::liberty();
    let mut random = generator(3);
    let (_, mut battle) = duel(MARINE, COLOSSUS, |_| {});
    let mut longer = Vec::new();
    for _ in 0..4000 {
        battle.units[1].life = 200.0;
        let before = battle.units[0].cooldown;
        battle.tick(&book, &mut random);
        let after = battle.units[0].cooldown;
        if after > before {
            longer.push(after - 13.7728);
        }
    }
    assert!(longer.iter().all(|more| (-1.0..2.0).contains(more)));
    let mean = longer.iter().sum::<f32>() / longer.len() as f32;
    assert!(longer.len() > 200 && (mean - 0.5).abs() < 0.2, "{mean} of {}", longer.len());
}

/// Otherwise what is under way would be forgotten when a unit takes aim again.
#[test]
fn weapons_are_slower_than_what_they_shoot() {
    for book in [Book::liberty(), Book::smaclite()] {
        let sooner = book.jitter.map_or(0.0, |[least, _]| -least);
        for UnitType { weapon, range, slop, period, wind_up, .. } in book.types {
            let flight = match weapon {
                Weapon::Missile(speed) => ((range + slop) / speed).ceil(),
                Weapon::Again(later) | Weapon::Line(later, _) => f32::from(later),
                Weapon::Heal | Weapon::Instant => 0.0,
            };
            assert!(weapon == Weapon::Heal || f32::from(wind_up) + flight < period - sooner);
        }
    }
}

#[test]
fn a_shot_is_cancelled_by_another_order() {
    let (book, mut battle) = duel(STALKER, ZEALOT, |_| {});
    ticks(&book, &mut battle, 2);
    assert_eq!(battle.units[0].wind_up, 2);
    assert!(battle.units[0].cooldown > 20.0);
    order(&mut battle, &[(0, Order::Stop)]);
    ticks(&book, &mut battle, 1);
    assert_eq!((battle.units[0].wind_up, battle.units[0].cooldown), (0, 0.0));
    ticks(&book, &mut battle, 20);
    assert_eq!(battle.units[1].shield, 50.0);
}

/// How much of a shield is left when the target leaps away while it is aimed at.
fn shield_of_who_leaps(shooter: u8, to: f32) -> f32 {
    let book = liberty();
    let mut battle = battle(&book, &[(shooter, [10.0; 2])], &[(ZEALOT, [16.0, 10.0])]);
    order(&mut battle, &[(0, Order::Attack(1))]);
    ticks(&book, &mut battle, 1);
    battle.units[1].place = [10.0 + to, 10.0];
    ticks(&book, &mut battle, 12);
    battle.units[1].shield
}

#[test]
fn a_target_that_leaves_is_still_shot_at_within_the_slop() {
    // The range ends at 7.125, and is 1 longer for who has begun.
    assert_eq!(shield_of_who_leaps(STALKER, 8.1), 40.0);
    assert_eq!(shield_of_who_leaps(STALKER, 8.4), 50.0);
    // A colossus has none.
    assert_eq!(shield_of_who_leaps(COLOSSUS, 7.4), 10.0);
    assert_eq!(shield_of_who_leaps(COLOSSUS, 8.3), 50.0);
}

#[test]
fn a_missile_outlives_its_shooter_and_not_its_target() {
    let shot = |shooter_dies: bool, target_dies: bool| {
        let (book, mut battle) = duel(STALKER, ZEALOT, |battle| {
            battle.units[1].place = [20.0, 16.0];
        });
        until(&book, &mut battle, |battle| battle.units[0].flight > 1);
        for (unit, dies) in [(0, shooter_dies), (1, target_dies)] {
            if dies {
                battle.units[unit].life = 0.0;
            }
        }
        ticks(&book, &mut battle, 8);
        battle.units[1].shield
    };
    assert_eq!([shot(false, false), shot(true, false), shot(false, true)], [40.0, 40.0, 50.0]);
}

#[test]
fn a_zealot_strikes_twice_if_it_lives() {
    let strikes = |dies: bool| {
        let (book, mut battle) = duel(ZEALOT, COLOSSUS, |_| {});
        ticks(&book, &mut battle, 1);
        assert_eq!(battle.units[1].shield, 142.0);
        if dies {
            battle.units[0].life = 0.0;
        }
        ticks(&book, &mut battle, 3);
        assert_eq!(battle.units[1].shield, 142.0);
        ticks(&book, &mut battle, 1);
        battle.units[1].shield
    };
    assert_eq!([strikes(false), strikes(true)], [134.0, 142.0]);
}

#[test]
fn a_colossus_burns_across_the_way_to_its_target() {
    let book = liberty();
    let enemies = [
        (ZEALOT, [14.0, 10.0]),
        // Within 1.25 and its radius of 0.5 to a side, and not.
        (ZEALOT, [14.0, 11.7]),
        (ZEALOT, [14.0, 8.2]),
        // Behind: within 0.15 and its radius, and not.
        (MARINE, [14.5, 11.0]),
        (MARINE, [14.6, 9.5]),
        (MEDIVAC, [14.0, 10.0]),
    ];
    let allies = [(COLOSSUS, [10.0, 10.0]), (ZEALOT, [14.0, 9.0])];
    let mut battle = battle(&book, &allies, &enemies);
    order(&mut battle, &[(0, Order::Attack(2))]);
    ticks(&book, &mut battle, 8);
    let hurt = battle.units[..8].iter().map(|unit| unit.unhurt < u8::MAX).collect::<Vec<_>>();
    assert_eq!(hurt, [false, false, true, true, false, true, false, false]);
    // Two hits.
    assert_eq!(battle.units[2].shield, 10.0);
}

#[test]
fn a_beam_ends_with_its_colossus_and_not_with_its_target() {
    let beam = |dies: usize| {
        let book = liberty();
        let enemies = [(ZEALOT, [14.0, 10.0]), (ZEALOT, [14.0, 11.1])];
        let mut battle = battle(&book, &[(COLOSSUS, [10.0, 10.0])], &enemies);
        order(&mut battle, &[(0, Order::Attack(1))]);
        ticks(&book, &mut battle, 4);
        battle.units[dies].life = 0.0;
        ticks(&book, &mut battle, 6);
        battle.units[2].shield
    };
    assert_eq!([beam(0), beam(1)], [50.0, 10.0]);
}

#[test]
fn both_may_fall_at_once() {
    let book = liberty();
    let mut duel = battle(&book, &[(ZEALOT, [10.0; 2])], &[(ZEALOT, [11.0, 10.0])]);
    order(&mut duel, &[(0, Order::Attack(1)), (1, Order::Attack(0))]);
    let over = |battle: &Battle| battle.living().contains(&0);
    while !over(&duel) {
        ticks(&book, &mut duel, 1);
    }
    assert_eq!(duel.living(), [0, 0]);
    let dead = &duel.units[0];
    let nothing = (0.0, 0.0, Order::Stop, NOBODY);
    assert_eq!((dead.life, dead.shield, dead.order, dead.target), nothing);
}

#[test]
fn one_medivac_is_enough_for_a_patient() {
    let book = liberty();
    let allies = [(MEDIVAC, [10.0; 2]), (MEDIVAC, [12.0, 10.0]), (MARINE, [11.0, 10.0])];
    let mut battle = battle(&book, &allies, &[(MARINE, [30.0; 2])]);
    order(&mut battle, &[(0, Order::Heal(2)), (1, Order::Heal(2))]);
    battle.units[2].life = 20.0;
    ticks(&book, &mut battle, 16);
    assert!((battle.units[2].life - 29.0).abs() < 1e-4);
    let energy = [0, 1].map(|medivac: usize| battle.units[medivac].energy);
    assert!((energy[0] - (50.0 - 9.0 * 0.33 + 0.5625)).abs() < 1e-3);
    assert!((energy[1] - 50.5625).abs() < 1e-4);
    // Nobody has more than his full life.
    ticks(&book, &mut battle, 32);
    assert_eq!(battle.units[2].life, 45.0);
    // What there is no energy for is not healed.
    battle.units[2].life = 20.0;
    (battle.units[0].energy, battle.units[1].order) = (0.0, Order::Stop);
    ticks(&book, &mut battle, 2);
    assert!(battle.units[2].life < 20.3, "{}", battle.units[2].life);
}

#[test]
fn who_is_far_dead_or_of_metal_is_not_healed() {
    let book = liberty();
    let allies = [(MEDIVAC, [10.0; 2]), (MARINE, [15.5, 10.0]), (STALKER, [10.0, 12.0])];
    let mut battle = battle(&book, &allies, &[(MARINE, [30.0; 2])]);
    battle.units[1].life = 20.0;
    battle.units[2].life = 20.0;
    order(&mut battle, &[(0, Order::Heal(2))]);
    ticks(&book, &mut battle, 1);
    assert_eq!((battle.units[2].life, battle.units[0].order), (20.0, Order::Stop));
    // The gap is 4.375: it comes nearer first, from rest.
    order(&mut battle, &[(0, Order::Heal(1))]);
    let healed = until(&book, &mut battle, |battle| battle.units[1].life > 20.0);
    assert!(healed > 8 && battle.distance(0, 1) <= 4.0 + 0.75 + 0.375, "{healed}");
    battle.units[1].life = 0.0;
    ticks(&book, &mut battle, 1);
    assert_eq!((battle.units[1].life, battle.units[0].order), (0.0, Order::Stop));
}

#[test]
fn shields_grow_ten_seconds_after_the_last_wound() {
    let (book, mut battle) = duel(MARINE, ZEALOT, |_| {});
    until(&book, &mut battle, |battle| battle.units[1].unhurt == 1);
    order(&mut battle, &[(0, Order::Stop)]);
    ticks(&book, &mut battle, 158);
    assert_eq!(battle.units[1].shield, 44.0);
    ticks(&book, &mut battle, 16);
    assert_eq!(battle.units[1].shield, 46.0);
    ticks(&book, &mut battle, 40);
    assert_eq!(battle.units[1].shield, 50.0);
}

#[test]
fn an_order_holds_until_its_target_is_dead() {
    let book = liberty();
    let enemies = [(ZEALOT, [20.0, 10.0]), (MEDIVAC, [12.0, 10.0])];
    let mut battle = battle(&book, &[(MARAUDER, [10.0; 2])], &enemies);
    // What it can not hit is no target.
    order(&mut battle, &[(0, Order::Attack(2))]);
    ticks(&book, &mut battle, 1);
    assert_eq!((battle.units[0].order, battle.units[0].target), (Order::Stop, NOBODY));
    // It follows, stops within range, and shoots.
    order(&mut battle, &[(0, Order::Attack(1))]);
    until(&book, &mut battle, |battle| battle.units[1].unhurt < u8::MAX);
    assert!((7.0..7.0625).contains(&battle.distance(0, 1)), "{}", battle.distance(0, 1));
    battle.units[1].life = 0.0;
    ticks(&book, &mut battle, 1);
    assert_eq!((battle.units[0].order, battle.units[0].target), (Order::Stop, NOBODY));
}

#[test]
fn who_can_hit_whom() {
    let book = Book::liberty();
    for shooter in 0..6 {
        let can: Vec<bool> = (0..6).map(|target| book.can_hit(shooter, target)).collect();
        let (ground, air) = (shooter != 3, shooter == 2 || shooter == 4);
        assert_eq!(can, [ground, ground, ground, air, ground, ground], "{shooter}");
        let heals: Vec<bool> = (0..6).map(|target| book.can_heal(shooter, target)).collect();
        let heals_life = shooter == 3;
        assert_eq!(heals, [false, heals_life, heals_life, false, false, heals_life], "{shooter}");
    }
}

/// How many of so many fights between equal teams, point for point opposite, each side wins.
fn mirrored(team: &[u8], fights: u64) -> [f32; 2] {
    let book = Book::liberty();
    let mut won = [0.0; 2];
    for seed in 0..fights {
        let mut random = generator(seed);
        let spread = |number: usize| {
            let far = 1.3 * (number as f32 + 0.1 * (seed % 7) as f32);
            [12.0 - far / 3.0, 14.0 + far]
        };
        let near: Vec<_> = team.iter().enumerate().map(|(at, kind)| (*kind, spread(at))).collect();
        let far: Vec<_> = near.iter().map(|(kind, [x, y])| (*kind, [32.0 - x, 32.0 - y])).collect();
        let mut battle = battle(&book, &near, &far);
        for unit in 0..battle.count {
            let [x, y] = battle.units[unit].place;
            battle.units[unit].order = Order::Advance([32.0 - x, 32.0 - y]);
        }
        while !battle.living().contains(&0) {
            battle.tick(&book, &mut random);
        }
        let [allies, enemies] = battle.living();
        (won[0], won[1]) = (won[0] + f32::from(allies != 0), won[1] + f32::from(enemies != 0));
    }
    won.map(|won| won / fights as f32)
}

#[test]
fn no_side_is_preferred_and_draws_are_possible() {
    for team in [&[MARINE; 3][..], &[STALKER, STALKER, ZEALOT, ZEALOT, ZEALOT]] {
        let [near, far] = mirrored(team, 400);
        assert!((near - far).abs() < 0.14, "{team:?}: {near} {far}");
        assert!(near + far > 0.9, "{team:?}: {near} {far}");
    }
    let [near, far] = mirrored(&[ZEALOT], 400);
    assert!((near - far).abs() < 0.14, "{near} {far}");
    assert!((0.5..0.99).contains(&(near + far)), "{near} {far}");
}
