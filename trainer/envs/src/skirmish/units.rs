//! Types of units, by two rule books.

use serde::Deserialize;

/// Types of units.
pub(super) const TYPES: usize = 6;
/// Their names. Units of a team are in this order.
pub(super) const TYPE_NAMES: [&str; TYPES] =
    ["colossus", "marauder", "marine", "medivac", "stalker", "zealot"];
pub(super) const COLOSSUS: u8 = 0;
pub(super) const MARAUDER: u8 = 1;
pub(super) const MARINE: u8 = 2;
pub(super) const MEDIVAC: u8 = 3;
pub(super) const STALKER: u8 = 4;
pub(super) const ZEALOT: u8 = 5;

/// Ticks of a second.
const SECOND: f32 = 16.0;
/// Most energy.
pub(super) const FULL_ENERGY: f32 = 200.0;

/// What a unit gets in the way of: others of its layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layer {
    Ground,
    /// Strides over those on the ground.
    Giant,
    Air,
}

/// What comes of a shot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Weapon {
    /// None: it heals.
    Heal,
    /// All hits at once.
    Instant,
    /// All hits when a missile arrives, which flies so far in a tick.
    Missile(f32),
    /// One hit at once, another one so many ticks later.
    Again(u8),
    /// So many ticks later all hits on everybody upon a line across the way to the foe, that reaches so far to both sides.
    Line(u8, f32),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UnitType {
    pub(super) life: f32,
    pub(super) shield: f32,
    /// What each hit on its life is less by.
    pub(super) armor: f32,
    /// At the start.
    pub(super) energy: f32,
    /// Of a hit.
    pub(super) damage: f32,
    /// What a hit is more on the light, and on the armored.
    pub(super) bonus: [f32; 2],
    pub(super) hits: u8,
    pub(super) weapon: Weapon,
    pub(super) hits_air: bool,
    /// Ticks from one shot to the next.
    pub(super) period: f32,
    /// Ticks from taking aim to the shot.
    pub(super) wind_up: u8,
    /// How far it shoots or heals, from edge to edge.
    pub(super) range: f32,
    /// How much farther its target may be gone when it has begun.
    pub(super) slop: f32,
    /// How far it comes in a tick.
    pub(super) speed: f32,
    /// What it gains in a tick; infinite of those that are at full speed at once.
    pub(super) acceleration: f32,
    /// Where its edge is.
    pub(super) radius: f32,
    /// What keeps others off.
    pub(super) body: f32,
    pub(super) layer: Layer,
    pub(super) is_armored: bool,
    pub(super) is_biological: bool,
}

/// How enemies find whom they shoot at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scan {
    /// The nearest by the gap between edges; whoever hurt them or a comrade if there is none.
    Nearest,
    /// Whoever heals, then the nearest by centres; whoever is after them, however far.
    HealersFirst,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Book {
    pub(super) types: [UnitType; TYPES],
    /// Of the map, whose places are from 0 to this.
    pub(super) side: f32,
    /// Ticks by which a shot's period is longer, at least and at most.
    pub(super) jitter: Option<[f32; 2]>,
    pub(super) scan: Scan,
    /// Whether units go around those in their way, and make way for friends, or run against whoever stands.
    pub(super) evades: bool,
    /// What is left of a hit on life at least.
    pub(super) least_damage: f32,
}

/// Which book is played by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Rules {
    Liberty,
    Smaclite,
}

impl Rules {
    pub(super) fn book(self) -> Book {
        match self {
            Self::Liberty => Book::liberty(),
            Self::Smaclite => Book::smaclite(),
        }
    }
}

impl Book {
    /// The numbers of the campaign Wings of Liberty, which the maps of SMAC are based on: 16 ticks are a second at normal
    /// speed.
    pub(super) fn liberty() -> Self {
        let common = UnitType {
            life: 0.0,
            shield: 0.0,
            armor: 1.0,
            energy: 0.0,
            damage: 0.0,
            bonus: [0.0; 2],
            hits: 1,
            weapon: Weapon::Instant,
            hits_air: false,
            period: 0.0,
            wind_up: 0,
            range: 6.0,
            slop: 1.0,
            speed: 2.25 / SECOND,
            acceleration: f32::INFINITY,
            radius: 0.5,
            body: 0.375,
            layer: Layer::Ground,
            is_armored: true,
            is_biological: false,
        };
        let colossus = UnitType {
            life: 200.0,
            shield: 150.0,
            damage: 20.0,
            hits: 2,
            weapon: Weapon::Line(6, 1.25),
            period: 2.2 * SECOND,
            wind_up: 1,
            slop: 0.0,
            radius: 1.0,
            body: 0.75,
            layer: Layer::Giant,
            ..common
        };
        let marauder = UnitType {
            life: 125.0,
            damage: 10.0,
            bonus: [0.0, 10.0],
            weapon: Weapon::Missile(20.0 / SECOND),
            period: 1.5 * SECOND,
            radius: 0.5625,
            body: 0.5,
            is_biological: true,
            ..common
        };
        let marine = UnitType {
            life: 45.0,
            armor: 0.0,
            damage: 6.0,
            hits_air: true,
            period: 0.8608 * SECOND,
            wind_up: 1,
            range: 5.0,
            radius: 0.375,
            is_armored: false,
            is_biological: true,
            ..common
        };
        let medivac = UnitType {
            life: 150.0,
            energy: 50.0,
            weapon: Weapon::Heal,
            range: 4.0,
            speed: 2.75 / SECOND,
            acceleration: 2.3125 / SECOND / SECOND,
            radius: 0.75,
            body: 0.75,
            layer: Layer::Air,
            ..common
        };
        let stalker = UnitType {
            life: 80.0,
            shield: 80.0,
            damage: 10.0,
            bonus: [0.0, 4.0],
            weapon: Weapon::Missile(18.75 / SECOND),
            hits_air: true,
            period: 1.44 * SECOND,
            wind_up: 3,
            speed: 2.9531 / SECOND,
            radius: 0.625,
            body: 0.625,
            ..common
        };
        let zealot = UnitType {
            life: 100.0,
            shield: 50.0,
            damage: 8.0,
            hits: 2,
            weapon: Weapon::Again(4),
            period: 1.2 * SECOND,
            range: 0.1,
            is_armored: false,
            is_biological: true,
            ..common
        };
        Self {
            types: [colossus, marauder, marine, medivac, stalker, zealot],
            side: 32.0,
            jitter: Some([-1.0, 2.0]),
            scan: Scan::Nearest,
            evades: true,
            least_damage: 0.5,
        }
    }

    /// The numbers of SMAClite (Michalski et al. 2023): a newer balance on a faster clock, simple weapons, no chance.
    pub(super) fn smaclite() -> Self {
        let mut book = Self::liberty();
        let periods = [1.07, 1.07, 0.61, 0.0, 1.34, 0.86];
        let speeds = [3.15, 3.15, 3.15, 3.5, 4.13, 3.15];
        for ((nature, period), speed) in book.types.iter_mut().zip(periods).zip(speeds) {
            nature.period = period * SECOND;
            nature.wind_up = 0;
            nature.speed = speed / SECOND;
            nature.acceleration = f32::INFINITY;
            nature.body = nature.radius;
            if nature.weapon != Weapon::Heal {
                nature.weapon = Weapon::Instant;
            }
        }
        let [colossus, .., stalker, _] = &mut book.types;
        colossus.damage = 10.0;
        colossus.bonus = [5.0, 0.0];
        colossus.range = 7.0;
        colossus.weapon = Weapon::Line(0, 1.4);
        colossus.layer = Layer::Ground;
        stalker.damage = 13.0;
        stalker.bonus = [0.0, 5.0];
        Self { jitter: None, scan: Scan::HealersFirst, evades: false, least_damage: 0.0, ..book }
    }

    /// Whether a shooter of one type can hit units of another one.
    #[inline]
    pub(super) fn can_hit(&self, shooter: usize, target: usize) -> bool {
        let (shooter, target) = (&self.types[shooter], &self.types[target]);
        shooter.weapon != Weapon::Heal && (shooter.hits_air || target.layer != Layer::Air)
    }

    /// Whether a unit of one type can heal units of another one.
    #[inline]
    pub(super) fn can_heal(&self, healer: usize, patient: usize) -> bool {
        let (healer, patient) = (&self.types[healer], &self.types[patient]);
        healer.weapon == Weapon::Heal && patient.is_biological && patient.layer != Layer::Air
    }
}
