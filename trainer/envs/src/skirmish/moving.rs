//! How units walk: around those in their way, and apart from those they overlap.

use super::battle::{Battle, CAPACITY, NOBODY, Point, UnitSet, each, length};
use super::fight::{Scene, direction};
use super::orders::Intent;
use super::units::Layer;

/// How far beside its body somebody who is in the way may be, how far ahead, and how near it must be to be evaded.
const GRAZES: f32 = 0.02;
const AHEAD: f32 = 0.4;
const NEAR: f32 = 0.25;
/// Length of a way along somebody under which it is taken on the preferred side.
const HEAD_ON: f32 = 0.15;
/// The share of its speed under which a unit is blocked, and for how many ticks until it changes sides.
const CREEPING: f32 = 0.2;
const PATIENCE: u8 = 8;
/// Rounds of separation, the most that one of them moves a unit, and by how much those in the air give way.
const ROUNDS: usize = 2;
const PUSH: f32 = 0.25;
const AIR: f32 = 0.25;

impl Battle {
    /// All walk by where all were, and are pushed apart.
    pub(super) fn move_all(&mut self, scene: &Scene<'_>) {
        let mut places = [Point::default(); CAPACITY];
        let everybody = scene.everybody();
        each(everybody).for_each(|unit| places[unit] = self.units[unit].place);
        let before = places;
        let layers = self.layers(scene);
        let mut moving = 0;
        for unit in each(everybody) {
            match scene.intents[unit] {
                Intent::Walk(goal) => {
                    places[unit] = self.step(scene, &layers, unit, goal);
                    moving |= 1 << unit;
                }
                _ => self.units[unit].speed = 0.0,
            }
        }
        for _ in 0..ROUNDS {
            if !self.separate(scene, &layers, moving, &mut places) {
                break;
            }
        }
        for unit in each(everybody) {
            let place = places[unit].map(|part| part.clamp(0.0, scene.book.side));
            let [x, y] = before[unit];
            let came = length([place[0] - x, place[1] - y]);
            let speed = scene.book.types[self.units[unit].kind()].speed;
            let is_blocked = moving >> unit & 1 == 1 && came < CREEPING * speed;
            let unit = &mut self.units[unit];
            unit.place = place;
            unit.blocked = if is_blocked { unit.blocked.saturating_add(1) } else { 0 };
            if is_blocked && unit.blocked.is_multiple_of(PATIENCE) {
                unit.passes_left = !unit.passes_left;
            }
        }
    }

    /// The living of each layer.
    fn layers(&self, scene: &Scene<'_>) -> [UnitSet; 3] {
        let mut layers = [0; 3];
        for unit in each(scene.everybody()) {
            layers[self.layer(scene, unit)] |= 1 << unit;
        }
        layers
    }

    fn layer(&self, scene: &Scene<'_>, unit: usize) -> usize {
        scene.book.types[self.units[unit].kind()].layer as usize
    }

    /// Where a unit comes to on its way.
    fn step(
        &mut self,
        scene: &Scene<'_>,
        layers: &[UnitSet; 3],
        unit: usize,
        goal: Point,
    ) -> Point {
        let nature = &scene.book.types[self.units[unit].kind()];
        let [x, y] = self.units[unit].place;
        let (mut ahead, far) = direction([goal[0] - x, goal[1] - y]);
        let speed = (self.units[unit].speed + nature.acceleration).min(nature.speed);
        self.units[unit].speed = speed;
        if nature.layer != Layer::Air && scene.book.evades {
            let mut others = layers[self.layer(scene, unit)] & !(1 << unit);
            if self.units[unit].target != NOBODY {
                others &= !(1 << self.units[unit].target);
            }
            ahead = self.steer(scene, others, unit, ahead);
        }
        let far = far.min(speed);
        [x + ahead[0] * far, y + ahead[1] * far]
    }

    /// Turns along whoever stands in the way, and once more.
    fn steer(&self, scene: &Scene<'_>, others: UnitSet, unit: usize, ahead: Point) -> Point {
        let mut ahead = ahead;
        for _ in 0..2 {
            let Some((blocker, bodies)) = self.blocker(scene, others, unit, ahead) else { break };
            let (toward, far) = direction(self.way(unit, blocker));
            if far > bodies + NEAR {
                break;
            }
            let along = ahead[0] * toward[0] + ahead[1] * toward[1];
            let tangent = [ahead[0] - along * toward[0], ahead[1] - along * toward[1]];
            let (turned, free) = direction(tangent);
            ahead = match self.units[unit].passes_left {
                _ if free >= HEAD_ON => turned,
                true => [-toward[1], toward[0]],
                false => [toward[1], -toward[0]],
            };
        }
        ahead
    }

    /// The first in the way, and how near it may be.
    fn blocker(
        &self,
        scene: &Scene<'_>,
        others: UnitSet,
        unit: usize,
        ahead: Point,
    ) -> Option<(usize, f32)> {
        let body = scene.book.types[self.units[unit].kind()].body;
        let (mut first, mut least) = (None, f32::INFINITY);
        for other in each(others) {
            let bodies = body + scene.book.types[self.units[other].kind()].body;
            let [x, y] = self.way(unit, other);
            let forward = x * ahead[0] + y * ahead[1];
            let sideways = (x * ahead[1] - y * ahead[0]).abs();
            let is_in_way =
                forward > 0.0 && forward <= bodies + AHEAD && sideways < bodies - GRAZES;
            if is_in_way && forward < least {
                (first, least) = (Some((other, bodies)), forward);
            }
        }
        first
    }

    /// Pushes apart who overlaps, all from where they are; whether anybody did.
    fn separate(
        &self,
        scene: &Scene<'_>,
        layers: &[UnitSet; 3],
        moving: UnitSet,
        places: &mut [Point; CAPACITY],
    ) -> bool {
        let mut pushes = [Point::default(); CAPACITY];
        let mut pushed = 0;
        for one in each(scene.everybody()) {
            let layer = self.layer(scene, one);
            let body = scene.book.types[self.units[one].kind()].body;
            for other in each(layers[layer] & (UnitSet::MAX << one << 1)) {
                let bodies = body + scene.book.types[self.units[other].kind()].body;
                let ([x, y], [there_x, there_y]) = (places[one], places[other]);
                let way = [there_x - x, there_y - y];
                if way[0] * way[0] + way[1] * way[1] >= bodies * bodies {
                    continue;
                }
                let (mut toward, far) = direction(way);
                if far == 0.0 {
                    toward = [1.0, 0.0];
                }
                let overlap = bodies - far;
                let overlap = if layer == Layer::Air as usize { overlap * AIR } else { overlap };
                let [yields, other_yields] = self.shares(scene, moving, one, other);
                for (part, toward) in toward.into_iter().enumerate() {
                    pushes[one][part] -= overlap * yields * toward;
                    pushes[other][part] += overlap * other_yields * toward;
                }
                pushed |= 1 << one | 1 << other;
            }
        }
        for unit in each(pushed) {
            let (toward, far) = direction(pushes[unit]);
            let far = far.min(PUSH);
            places[unit][0] += toward[0] * far;
            places[unit][1] += toward[1] * far;
        }
        pushed != 0
    }

    /// Which part of an overlap each of two gives way by.
    fn shares(&self, scene: &Scene<'_>, moving: UnitSet, one: usize, other: usize) -> [f32; 2] {
        let are_friends = (one < self.allies) == (other < self.allies);
        let weights = [one, other].map(|unit| match scene.intents[unit] {
            _ if moving >> unit & 1 == 1 => 1.0,
            Intent::Stand if are_friends && scene.book.evades => 0.5,
            _ => 0.0,
        });
        let both = weights[0] + weights[1];
        if both > 0.0 { weights.map(|weight| weight / both) } else { [0.5; 2] }
    }
}
