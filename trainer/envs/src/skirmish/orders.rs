//! What units make of their orders: whom they fight, and where they go.

use super::battle::{Battle, Intent, NOBODY, Order, Point, Scene, Unit, UnitSet, each, length};
use super::units::{Scan, Weapon};

/// From where on enemies see foes, and medivacs patients, from edge to edge.
const ACQUISITION: f32 = 5.0;
const PATIENTS: f32 = 6.0;
/// Energy without which a medivac takes no new patient by itself.
const ENERGY_TO_START: f32 = 5.0;
/// How near to a point agents have arrived, enemies that attack, and enemies that retreat: four find room there.
const CLOSE: f32 = 1e-3;
const ARRIVED: f32 = 1.0;
const RETREATED: f32 = 1.2;
/// Ticks for which a retreat is blocked until it is over.
const STUCK: u8 = 16;

impl Battle {
    /// Sets targets and intents of all that live.
    pub(super) fn decide(&mut self, scene: &mut Scene<'_>) {
        for number in each(scene.everybody()) {
            let intent = match self.units[number].order {
                Order::Stop => self.disengage(number, Intent::Stand),
                Order::Go(point) if number < self.allies => self.walk(number, point, CLOSE),
                Order::Go(point) => self.retreat(number, point),
                Order::Attack(target) | Order::Heal(target) => self.obey(scene, number, target),
                Order::Advance(point) => self.react(scene, number, point),
            };
            scene.intents[number] = intent;
        }
    }

    /// Has no target.
    fn disengage(&mut self, unit: usize, intent: Intent) -> Intent {
        self.units[unit].target = NOBODY;
        intent
    }

    /// Goes to a point until it is so near, and minds nobody.
    fn walk(&mut self, unit: usize, point: Point, near: f32) -> Intent {
        let [x, y] = self.units[unit].place;
        let is_there = length([point[0] - x, point[1] - y]) <= near;
        self.disengage(unit, if is_there { Intent::Stand } else { Intent::Walk(point) })
    }

    /// Minds nobody, and stays on guard where it ends.
    fn retreat(&mut self, number: usize, point: Point) -> Intent {
        let intent = self.walk(number, point, RETREATED);
        let unit = &mut self.units[number];
        if intent == Intent::Stand || unit.blocked >= STUCK {
            unit.order = Order::Advance(unit.place);
        }
        intent
    }

    /// An order to attack or to heal holds until its target is dead; one that can not be followed is none.
    fn obey(&mut self, scene: &Scene<'_>, unit: usize, target: u8) -> Intent {
        let [kind, other] = [unit, target.into()].map(|unit| self.units[unit].kind());
        let can = scene.book.can_hit(kind, other) || scene.book.can_heal(kind, other);
        if !can || scene.everybody() >> target & 1 == 0 {
            self.units[unit].order = Order::Stop;
            return self.disengage(unit, Intent::Stand);
        }
        self.units[unit].target = target;
        self.engage(scene, unit, target.into())
    }

    /// Attacks within range, and goes there otherwise.
    fn engage(&self, scene: &Scene<'_>, unit: usize, target: usize) -> Intent {
        let Unit { kind, wind_up, victim, .. } = self.units[unit];
        let nature = &scene.book.types[usize::from(kind)];
        let has_begun = wind_up > 0 && usize::from(victim) == target;
        let range = nature.range + if has_begun { nature.slop } else { 0.0 };
        if self.is_within(scene.book, range, unit, target) {
            Intent::Attack
        } else {
            Intent::Walk(self.units[target].place)
        }
    }

    /// What an enemy does by itself on its way to a point.
    fn react(&mut self, scene: &Scene<'_>, unit: usize, point: Point) -> Intent {
        let nature = &scene.book.types[self.units[unit].kind()];
        let target = match (nature.weapon, scene.book.scan) {
            (Weapon::Heal, _) => self.patient(scene, unit),
            (_, Scan::Nearest) => self.nearest(scene, unit).or_else(|| self.culprit(scene, unit)),
            (_, Scan::HealersFirst) => self.most_urgent(scene, unit),
        };
        let Some(target) = target else {
            return self.walk(unit, point, ARRIVED);
        };
        self.units[unit].target = target as u8;
        self.engage(scene, unit, target)
    }

    fn foes(&self, scene: &Scene<'_>, unit: usize) -> UnitSet {
        scene.living[usize::from(unit < self.allies)]
    }

    /// The target that it has if that is among these.
    fn kept(&self, unit: usize, among: UnitSet) -> Option<usize> {
        let target = self.units[unit].target;
        (target != NOBODY && among >> target & 1 == 1).then(|| target.into())
    }

    /// The foe that it has within range already, or the nearest one that it sees.
    fn nearest(&self, scene: &Scene<'_>, unit: usize) -> Option<usize> {
        let (book, kind) = (scene.book, self.units[unit].kind());
        let (foes, nature) = (self.foes(scene, unit), &book.types[kind]);
        let keeps = nature.range + nature.slop;
        let kept = self.kept(unit, foes).filter(|kept| self.is_within(book, keeps, unit, *kept));
        if kept.is_some() {
            return kept;
        }
        let sees = nature.range.max(ACQUISITION);
        let can_hit = |foe: &usize| book.can_hit(kind, self.units[*foe].kind());
        let seen = each(foes).filter(|foe| self.is_within(book, sees, unit, *foe)).filter(can_hit);
        least(seen.map(|foe| (self.gap(book, unit, foe), foe)))
    }

    /// Who hurt it or a comrade.
    fn culprit(&self, scene: &Scene<'_>, unit: usize) -> Option<usize> {
        let Unit { kind, attacker, .. } = self.units[unit];
        let lives = attacker != NOBODY && self.foes(scene, unit) >> attacker & 1 == 1;
        let attacker = lives.then_some(usize::from(attacker))?;
        scene.book.can_hit(kind.into(), self.units[attacker].kind()).then_some(attacker)
    }

    /// By the rules of SMAClite.
    fn most_urgent(&self, scene: &Scene<'_>, unit: usize) -> Option<usize> {
        let (book, kind) = (scene.book, self.units[unit].kind());
        let foes = self.foes(scene, unit);
        let is_after = |foe: usize| usize::from(self.units[foe].target) == unit;
        let heals = |foe: usize| book.types[self.units[foe].kind()].weapon == Weapon::Heal;
        let range = book.types[kind].range;
        let is_kept = |foe: &usize| is_after(*foe) || self.is_within(book, range, unit, *foe);
        let kept = self.kept(unit, foes).filter(is_kept);
        // While a foe lives that heals, everybody who is after somebody else looks around.
        let is_settled = |kept: &usize| heals(*kept) || !each(foes).any(heals);
        if let Some(kept) = kept.filter(is_settled) {
            return Some(kept);
        }
        let can_hit = |foe: &usize| book.can_hit(kind, self.units[*foe].kind());
        let seen = each(foes).filter(can_hit).filter_map(|foe| {
            let nature = &book.types[self.units[foe].kind()];
            let distance = self.distance(unit, foe);
            // Nobody is as far as that: healers are before all others.
            let rank = if heals(foe) { -1e3 } else { 0.0 };
            let is_seen = distance < ACQUISITION + nature.radius || is_after(foe);
            is_seen.then_some((rank + distance, foe))
        });
        least(seen).or(kept)
    }

    /// The comrade within reach that has lost most of its life, for a medivac.
    fn patient(&self, scene: &Scene<'_>, unit: usize) -> Option<usize> {
        let (book, Unit { kind, energy, .. }) = (scene.book, self.units[unit]);
        let is_wounded = |comrade: &usize| {
            let Unit { kind: other, life, .. } = self.units[*comrade];
            let full = book.types[usize::from(other)].life;
            book.can_heal(kind.into(), other.into()) && life < full
        };
        let comrades = scene.living[usize::from(unit >= self.allies)];
        let wounded = each(comrades).filter(is_wounded);
        let near = wounded.filter(|comrade| self.is_within(book, PATIENTS, unit, *comrade));
        let near = near.fold(0, |set, comrade| set | 1 << comrade);
        let kept = self.kept(unit, near);
        let range = book.types[usize::from(kind)].range;
        let kept = kept.filter(|kept| self.is_within(book, range, unit, *kept));
        if kept.is_some() {
            return kept;
        }
        if energy < ENERGY_TO_START {
            return None;
        }
        let share =
            |comrade: usize| self.units[comrade].life / book.types[self.units[comrade].kind()].life;
        let most = each(near).map(share).fold(f32::INFINITY, f32::min);
        let worst = each(near).filter(|comrade| share(*comrade) == most);
        least(worst.map(|comrade| (self.gap(book, unit, comrade), comrade)))
    }
}

/// Whose number is least, the first of several.
fn least(candidates: impl Iterator<Item = (f32, usize)>) -> Option<usize> {
    let least = |best: (f32, usize), next: (f32, usize)| if next.0 < best.0 { next } else { best };
    candidates.reduce(least).map(|(_, unit)| unit)
}
