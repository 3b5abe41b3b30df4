//! A tick: what was shot hits, units decide, walk, shoot and die, wounds heal.

use super::battle::{
    Battle, CAPACITY, Intent, NOBODY, Order, Scene, UnitSet, direction, each, length,
};
use super::units::{Book, FULL_ENERGY, Weapon};
use crate::random::{Random, unit};

/// Ticks without a wound until shields grow, and by how much in a tick.
const SHIELD_DELAY: u8 = 160;
const SHIELD_GAIN: f32 = 2.0 / 16.0;
const ENERGY_GAIN: f32 = 0.5625 / 16.0;
/// Life that a medivac gives in a tick, and the energy that each point of it takes.
const HEALED: f32 = 9.0 / 16.0;
const ENERGY_OF_LIFE: f32 = 0.33;
/// Ticks for which an attacker is remembered, and how near to a comrade its call for help is heard.
const ALARM: u8 = 32;
const CALL: f32 = 4.0;
/// Half the width of a line of fire.
const LINE_WIDTH: f32 = 0.15;

impl Battle {
    /// All units decide by how the tick begins, and nobody falls before all have shot: no side is first, and both may lose
    /// their last unit at once.
    pub(super) fn tick(&mut self, book: &Book, random: &mut Random) {
        let living = self.living();
        let mut scene = Scene { book, living, intents: [Intent::Stand; CAPACITY], hurt: 0 };
        self.land(&mut scene);
        self.bury(&mut scene);
        self.decide(&mut scene);
        self.move_all(&scene);
        self.shoot(&mut scene, random);
        self.bury(&mut scene);
        self.heal(&scene);
        self.recover(&scene);
    }

    /// What was shot earlier arrives.
    fn land(&mut self, scene: &mut Scene<'_>) {
        for shooter in 0..self.count {
            let unit = &mut self.units[shooter];
            if unit.flight == 0 {
                continue;
            }
            unit.flight -= 1;
            if unit.flight > 0 {
                continue;
            }
            let (victim, nature) = (usize::from(unit.victim), &scene.book.types[unit.kind()]);
            let lives = scene.everybody() >> shooter & 1 == 1;
            let finds = scene.everybody() >> victim & 1 == 1;
            match nature.weapon {
                Weapon::Missile(_) if finds => self.hit(scene, shooter, victim, nature.hits),
                Weapon::Again(_) if lives && finds => {
                    self.hit(scene, shooter, victim, nature.hits - 1);
                }
                // A beam needs its source; it burns where the target was even if that is dead.
                Weapon::Line(_, reach) if lives => self.burn(scene, shooter, victim, reach),
                _ => {}
            }
        }
    }

    /// So many hits. Shields take what they can, and armor is of life alone.
    fn hit(&mut self, scene: &mut Scene<'_>, shooter: usize, victim: usize, hits: u8) {
        let [nature, of_victim] =
            [shooter, victim].map(|unit| &scene.book.types[self.units[unit].kind()]);
        let damage = nature.damage + nature.bonus[usize::from(of_victim.is_armored)];
        let unit = &mut self.units[victim];
        for _ in 0..hits {
            let absorbed = damage.min(unit.shield);
            unit.shield -= absorbed;
            if damage > absorbed {
                let wound = damage - absorbed - of_victim.armor;
                unit.life -= wound.max(scene.book.least_damage);
            }
        }
        (unit.unhurt, unit.attacker, unit.alarm) = (0, shooter as u8, ALARM);
        scene.hurt |= 1 << victim;
    }

    /// Hits every foe on the ground whose circle touches a line across the way to the victim.
    fn burn(&mut self, scene: &mut Scene<'_>, shooter: usize, victim: usize, reach: f32) {
        let (ahead, _) = direction(self.way(shooter, victim));
        let (kind, hits) = (self.units[shooter].kind(), self.hits(scene.book, shooter));
        for foe in each(scene.living[usize::from(shooter < self.allies)]) {
            let of_foe = self.units[foe].kind();
            let [x, y] = self.way(victim, foe);
            let along = (ahead[0] * y - ahead[1] * x).abs() - reach;
            let across = (ahead[0] * x + ahead[1] * y).abs() - LINE_WIDTH;
            let apart = length([along.max(0.0), across.max(0.0)]);
            if scene.book.can_hit(kind, of_foe) && apart <= scene.book.types[of_foe].radius {
                self.hit(scene, shooter, foe, hits);
            }
        }
    }

    fn hits(&self, book: &Book, unit: usize) -> u8 {
        book.types[self.units[unit].kind()].hits
    }

    /// The dead leave.
    fn bury(&mut self, scene: &mut Scene<'_>) {
        if scene.hurt == 0 {
            return;
        }
        for number in each(scene.hurt) {
            let unit = &mut self.units[number];
            if !unit.is_alive() {
                // What it has shot flies on.
                (unit.life, unit.shield) = (0.0, 0.0);
                (unit.order, unit.target, unit.attacker) = (Order::Stop, NOBODY, NOBODY);
                (unit.cooldown, unit.wind_up) = (0.0, 0);
            }
        }
        scene.living = self.living();
    }

    /// Those whose target is within range take aim, and shoot when they have.
    fn shoot(&mut self, scene: &mut Scene<'_>, random: &mut Random) {
        for number in each(scene.everybody()) {
            let unit = &mut self.units[number];
            let nature = &scene.book.types[unit.kind()];
            if nature.weapon == Weapon::Heal {
                continue;
            }
            unit.cooldown = (unit.cooldown - 1.0).max(0.0);
            let attacks = scene.intents[number] == Intent::Attack;
            if unit.wind_up > 0 && !(attacks && unit.victim == unit.target) {
                (unit.wind_up, unit.cooldown, unit.victim) = (0, 0.0, NOBODY);
            }
            let fires = if unit.wind_up > 0 {
                unit.wind_up -= 1;
                unit.wind_up == 0
            } else if attacks && unit.cooldown <= 0.0 {
                // The period begins here, and what the cooldown was below zero is lost.
                unit.cooldown = nature.period + jitter(scene.book, random);
                (unit.wind_up, unit.victim) = (nature.wind_up, unit.target);
                unit.wind_up == 0
            } else {
                false
            };
            if fires {
                self.fire(scene, number);
            }
        }
    }

    fn fire(&mut self, scene: &mut Scene<'_>, shooter: usize) {
        let (target, hits) =
            (usize::from(self.units[shooter].victim), self.hits(scene.book, shooter));
        self.units[shooter].flight = match scene.book.types[self.units[shooter].kind()].weapon {
            Weapon::Heal => return,
            Weapon::Instant => {
                self.hit(scene, shooter, target, hits);
                0
            }
            Weapon::Again(later) => {
                self.hit(scene, shooter, target, 1);
                later
            }
            Weapon::Missile(speed) => {
                libm::ceilf(self.gap(scene.book, shooter, target) / speed).max(1.0) as u8
            }
            Weapon::Line(0, reach) => {
                self.burn(scene, shooter, target, reach);
                0
            }
            Weapon::Line(later, _) => later,
        };
    }

    /// One medivac is enough for a patient.
    fn heal(&mut self, scene: &Scene<'_>) {
        let mut healed: UnitSet = 0;
        for healer in each(scene.everybody()) {
            let unit = self.units[healer];
            let heals = scene.book.types[unit.kind()].weapon == Weapon::Heal
                && scene.intents[healer] == Intent::Attack;
            let is_free = heals && healed >> unit.target & 1 == 0;
            if !is_free || !self.units[usize::from(unit.target)].is_alive() {
                continue;
            }
            let patient = &mut self.units[usize::from(unit.target)];
            let missing = scene.book.types[patient.kind()].life - patient.life;
            let gift = HEALED.min(missing).min(unit.energy / ENERGY_OF_LIFE);
            patient.life += gift;
            self.units[healer].energy -= gift * ENERGY_OF_LIFE;
            healed |= 1 << unit.target;
        }
    }

    /// Shields and energy grow; comrades of the wounded are called, alarms are forgotten.
    fn recover(&mut self, scene: &Scene<'_>) {
        for number in each(scene.everybody()) {
            let unit = &mut self.units[number];
            let nature = &scene.book.types[unit.kind()];
            unit.unhurt = unit.unhurt.saturating_add(1);
            if unit.unhurt >= SHIELD_DELAY {
                unit.shield = (unit.shield + SHIELD_GAIN).min(nature.shield);
            }
            if nature.weapon == Weapon::Heal {
                unit.energy = (unit.energy + ENERGY_GAIN).min(FULL_ENERGY);
            }
            unit.alarm = unit.alarm.saturating_sub(1);
            if unit.alarm == 0 {
                unit.attacker = NOBODY;
            }
        }
        for wounded in each(scene.hurt & scene.everybody()) {
            let attacker = self.units[wounded].attacker;
            let comrades = scene.living[usize::from(wounded >= self.allies)];
            for comrade in each(comrades & !scene.hurt) {
                if self.distance(wounded, comrade) <= CALL {
                    (self.units[comrade].attacker, self.units[comrade].alarm) = (attacker, ALARM);
                }
            }
        }
    }
}

/// Ticks that chance adds to the period of a shot.
fn jitter(book: &Book, random: &mut Random) -> f32 {
    book.jitter.map_or(0.0, |[least, most]| least + (most - least) * unit(random) as f32)
}
