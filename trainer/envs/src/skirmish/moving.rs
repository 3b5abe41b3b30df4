//! How units walk: around those in their way, and apart from those they overlap.

use super::battle::{Battle, CAPACITY, Intent, NOBODY, Point, Scene, UnitSet, direction, each};
use super::units::{Book, Layer};

/// How near others come into question, beside both bodies: no two units come nearer in a tick.
const NEIGHBOURHOOD: f32 = 0.6;
/// How near somebody in the way must be to be evaded, and how far beside its body it may be grazed.
const NEAR: f32 = 0.25;
const GRAZES: f32 = 0.02;
/// Length of a way along somebody under which it is taken on the preferred side.
const HEAD_ON: f32 = 0.15;
/// The share of its speed under which a unit is blocked, and for how many ticks until it changes sides.
const CREEPING: f32 = 0.2;
const PATIENCE: u8 = 8;
/// Rounds of separation, and by how much less those in the air are moved.
const ROUNDS: usize = 2;
const AIR: f32 = 0.25;

/// Where the living are, and who is near whom of its layer.
struct Crowd {
    places: [Point; CAPACITY],
    bodies: [f32; CAPACITY],
    neighbours: [UnitSet; CAPACITY],
    flying: UnitSet,
    moving: UnitSet,
}

impl Battle {
    /// All walk by where all were, and are pushed apart.
    pub(super) fn move_all(&mut self, scene: &Scene<'_>) {
        let mut crowd = self.crowd(scene);
        let mut places = crowd.places;
        for unit in each(scene.everybody()) {
            match scene.intents[unit] {
                Intent::Walk(goal) => places[unit] = self.step(scene.book, &crowd, unit, goal),
                _ => self.units[unit].speed = 0.0,
            }
        }
        crowd.places = places;
        for _ in 0..ROUNDS {
            if !self.separate(scene, &mut crowd) {
                break;
            }
        }
        each(scene.everybody()).for_each(|unit| self.settle(scene.book, &crowd, unit));
    }

    fn crowd(&self, scene: &Scene<'_>) -> Crowd {
        let mut crowd = Crowd {
            places: [Point::default(); CAPACITY],
            bodies: [0.0; CAPACITY],
            neighbours: [0; CAPACITY],
            flying: 0,
            moving: 0,
        };
        let mut layers = [0; 3];
        for unit in each(scene.everybody()) {
            let nature = &scene.book.types[self.units[unit].kind()];
            let ([x, y], body) = (self.units[unit].place, nature.body);
            (crowd.places[unit], crowd.bodies[unit]) = ([x, y], body);
            let is_moving = matches!(scene.intents[unit], Intent::Walk(_));
            crowd.moving |= UnitSet::from(is_moving) << unit;
            let layer: &mut UnitSet = &mut layers[nature.layer as usize];
            for other in each(*layer) {
                let [there_x, there_y] = crowd.places[other];
                let (east, north) = (there_x - x, there_y - y);
                let near = body + crowd.bodies[other] + NEIGHBOURHOOD;
                let is_near = UnitSet::from(east * east + north * north < near * near);
                crowd.neighbours[unit] |= is_near << other;
                crowd.neighbours[other] |= is_near << unit;
            }
            *layer |= 1 << unit;
        }
        crowd.flying = layers[Layer::Air as usize];
        crowd
    }

    /// Where a unit comes to on its way.
    fn step(&mut self, book: &Book, crowd: &Crowd, unit: usize, goal: Point) -> Point {
        let nature = &book.types[self.units[unit].kind()];
        let [x, y] = self.units[unit].place;
        let (mut ahead, far) = direction([goal[0] - x, goal[1] - y]);
        let speed = (self.units[unit].speed + nature.acceleration).min(nature.speed);
        self.units[unit].speed = speed;
        if book.evades {
            ahead = self.evade(crowd, unit, ahead);
        } else if self.units[unit].blocked > 0 {
            // Aslant, or those who stand behind each other would never pass.
            let side = if self.units[unit].passes_left { 1.0 } else { -1.0 };
            ahead = direction([ahead[0] - side * ahead[1], ahead[1] + side * ahead[0]]).0;
        }
        let far = far.min(speed);
        [x + ahead[0] * far, y + ahead[1] * far]
    }

    /// Turns along whoever stands in the way but the own target, and once more.
    fn evade(&self, crowd: &Crowd, unit: usize, mut ahead: Point) -> Point {
        let mut others = crowd.neighbours[unit] & !crowd.flying;
        if self.units[unit].target != NOBODY {
            others &= !(1 << self.units[unit].target);
        }
        for _ in 0..2 {
            let Some(blocker) = self.blocker(crowd, others, unit, ahead) else { break };
            let (toward, _) = direction(self.way(unit, blocker));
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

    /// The first in the way of those that are near.
    fn blocker(&self, crowd: &Crowd, others: UnitSet, unit: usize, ahead: Point) -> Option<usize> {
        let (mut first, mut least) = (None, f32::INFINITY);
        for other in each(others) {
            let bodies = crowd.bodies[unit] + crowd.bodies[other];
            let [x, y] = self.way(unit, other);
            let forward = x * ahead[0] + y * ahead[1];
            let sideways = (x * ahead[1] - y * ahead[0]).abs();
            let is_near = x * x + y * y <= (bodies + NEAR) * (bodies + NEAR);
            if is_near && sideways < bodies - GRAZES && forward > 0.0 && forward < least {
                (first, least) = (Some(other), forward);
            }
        }
        first
    }

    /// Pushes apart who overlaps, all from where they are; whether anybody did.
    fn separate(&self, scene: &Scene<'_>, crowd: &mut Crowd) -> bool {
        let mut pushes = [Point::default(); CAPACITY];
        let mut pushed: UnitSet = 0;
        for one in each(scene.everybody()) {
            for other in each(crowd.neighbours[one] & (UnitSet::MAX << one << 1)) {
                let bodies = crowd.bodies[one] + crowd.bodies[other];
                let ([x, y], [there_x, there_y]) = (crowd.places[one], crowd.places[other]);
                let way = [there_x - x, there_y - y];
                if way[0] * way[0] + way[1] * way[1] >= bodies * bodies {
                    continue;
                }
                let (toward, far) = direction(way);
                let [x, y] = if far > 0.0 { toward } else { [1.0, 0.0] };
                let give = if crowd.flying >> one & 1 == 1 { AIR } else { 1.0 };
                let [back, forth] = self.shares(scene, [one, other]);
                let [back, forth] = [-back, forth].map(|share| share * (bodies - far) * give);
                pushes[one] = [pushes[one][0] + x * back, pushes[one][1] + y * back];
                pushes[other] = [pushes[other][0] + x * forth, pushes[other][1] + y * forth];
                pushed |= 1 << one | 1 << other;
            }
        }
        for unit in each(pushed) {
            let [x, y] = crowd.places[unit];
            crowd.places[unit] = [x + pushes[unit][0], y + pushes[unit][1]];
        }
        pushed != 0
    }

    /// Which part of an overlap each of two gives way by: who walks does, who attacks does not.
    fn shares(&self, scene: &Scene<'_>, pair: [usize; 2]) -> [f32; 2] {
        let are_friends = (pair[0] < self.allies) == (pair[1] < self.allies);
        let weights = pair.map(|unit| match scene.intents[unit] {
            Intent::Walk(_) => 1.0,
            Intent::Stand if are_friends && scene.book.evades => 0.5,
            _ => 0.0,
        });
        let both = weights[0] + weights[1];
        if both > 0.0 { weights.map(|weight| weight / both) } else { [0.5; 2] }
    }

    /// Takes its new place, on the map, and no farther than its speed: nobody is pushed ahead.
    fn settle(&mut self, book: &Book, crowd: &Crowd, number: usize) {
        let unit = &mut self.units[number];
        let place = crowd.places[number].map(|part| part.clamp(0.0, book.side));
        let ([x, y], speed) = (unit.place, book.types[unit.kind()].speed);
        let (way, far) = direction([place[0] - x, place[1] - y]);
        let is_pushed = far > speed;
        unit.place = if is_pushed { [x + way[0] * speed, y + way[1] * speed] } else { place };
        if crowd.moving >> number & 1 == 0 || far >= CREEPING * speed {
            unit.blocked = 0;
            return;
        }
        unit.blocked = unit.blocked.saturating_add(1);
        if unit.blocked.is_multiple_of(PATIENCE) {
            unit.passes_left = !unit.passes_left;
        }
    }
}
