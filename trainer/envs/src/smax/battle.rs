//! The state of a battle, and the rules of one step: what enemies do, then eight ticks of shooting, moving and pushing.

use alloc::format;
use alloc::vec::Vec;

use super::units::{
    AttackMode, DAMAGE, HEALTH, PERIOD, RADIUS, RANGE, RuleBook, Rules, SIGHT, SPEED, TYPES,
};
pub(super) use crate::battles::{CAPACITY, Point, length};
use crate::battles::{WAYS, heading};
use crate::bytes::{LAYOUT, Reader};
use crate::environment::StateError;
use crate::observation::{ActionSet, members};

/// Units, as bits.
type UnitSet = u64;

/// Places are from 0 to this, north is up.
pub(super) const SIDE: f32 = 32.0;
/// Seconds of a tick.
pub(super) const TICK: f32 = 1.0 / 16.0;
/// Ticks of a step.
const TICKS: usize = 8;
/// The first actions go. The next one stops, those behind it stand and attack a foe.
pub(super) const STOP: u8 = WAYS.len() as u8;
pub(super) const ATTACK: u8 = STOP + 1;
pub(super) const NOBODY: u8 = u8::MAX;

/// A unit between steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Unit {
    pub(super) kind: u8,
    /// What it did in the last step, by the numbers of its own actions.
    pub(super) order: u8,
    pub(super) health: u8,
    /// Of an enemy: the ally that it had within reach.
    pub(super) target: u8,
    pub(super) place: Point,
    /// Seconds until it may shoot; it sinks without bound.
    pub(super) cooldown: f32,
    /// Of an enemy: where it goes while it sees nobody, told by its first place.
    pub(super) goal: Point,
}

impl Unit {
    #[inline]
    pub(super) fn is_alive(&self) -> bool {
        self.health > 0
    }

    #[inline]
    pub(super) fn kind(&self) -> usize {
        self.kind.into()
    }

    /// Where it went in the last step.
    #[inline]
    pub(super) fn moved(&self) -> Point {
        WAYS.get(usize::from(self.order)).copied().unwrap_or_default()
    }
}

/// A battle between steps. Allies come first among units.
#[derive(Clone, Debug)]
pub(super) struct Battle {
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) allies: usize,
    /// Units of both teams.
    pub(super) count: usize,
    pub(super) units: [Unit; CAPACITY],
}

impl Battle {
    /// Before it begins; places are still to come.
    pub(super) fn of(allies: &[u8], enemies: &[u8]) -> Self {
        let mut units = [Unit::default(); CAPACITY];
        for (unit, kind) in units.iter_mut().zip(allies.iter().chain(enemies)) {
            let health = HEALTH[usize::from(*kind)];
            *unit = Unit { kind: *kind, health, order: STOP, target: NOBODY, ..Unit::default() };
        }
        let (allies, count) = (allies.len(), allies.len() + enemies.len());
        Self { steps: 0, episode_return: 0.0, allies, count, units }
    }

    fn sides(&self) -> [&[Unit]; 2] {
        self.units[..self.count].split_at(self.allies).into()
    }

    /// The types of both teams.
    pub(super) fn teams(&self) -> [Vec<u8>; 2] {
        self.sides().map(|team| team.iter().map(|unit| unit.kind).collect())
    }

    /// Allies and enemies that are alive.
    pub(super) fn alive(&self) -> [u32; 2] {
        self.sides().map(|team| team.iter().map(|unit| u32::from(unit.is_alive())).sum())
    }

    pub(super) fn is_over(&self, rules: &Rules) -> bool {
        self.steps > rules.max_steps || self.alive().contains(&0)
    }

    /// The way from one unit to another.
    #[inline]
    pub(super) fn way(&self, from: usize, to: usize) -> Point {
        let ([x, y], [there_x, there_y]) = (self.units[from].place, self.units[to].place);
        [there_x - x, there_y - y]
    }

    /// Whether both live, and are nearer than the distance that the first one's type has in a table.
    #[inline]
    fn is_near(&self, unit: usize, other: usize, distances: &[f32; TYPES]) -> bool {
        let is_there = self.units[unit].is_alive() && self.units[other].is_alive();
        is_there && length(self.way(unit, other)) < distances[self.units[unit].kind()]
    }

    #[inline]
    pub(super) fn sees(&self, unit: usize, other: usize) -> bool {
        self.is_near(unit, other, &SIGHT)
    }

    pub(super) fn foes(&self, unit: usize) -> usize {
        if unit < self.allies { self.count - self.allies } else { self.allies }
    }

    /// The foe of a number among its foes. Enemies count backwards.
    #[inline]
    fn foe(&self, unit: usize, number: usize) -> usize {
        if unit < self.allies { self.allies + number } else { self.allies - 1 - number }
    }

    /// The actions of a unit that come to something at once; the dead stop.
    pub(super) fn available(&self, unit: usize) -> ActionSet {
        let always = if self.units[unit].is_alive() { (1 << ATTACK) - 1 } else { 1 << STOP };
        (0..self.foes(unit)).fold(always, |set, number| {
            let is_near = self.is_near(unit, self.foe(unit, number), &RANGE);
            set | ActionSet::from(is_near) << (usize::from(ATTACK) + number)
        })
    }

    /// Writes what enemies do, of whom each decides alone; `draw` chooses among allies for one: whom it shoots at, or whom it
    /// goes to.
    pub(super) fn command(&mut self, rules: &Rules, mut draw: impl FnMut(usize, UnitSet) -> usize) {
        for enemy in self.allies..self.count {
            let Unit { place: [x, y], target: before, .. } = self.units[enemy];
            if self.steps == 0 {
                self.units[enemy].goal = [SIDE - x, SIDE - y];
            }
            let (seen, within, nearest) = self.look_out(enemy);
            let target = match rules.attack_mode {
                _ if within == 0 => NOBODY,
                _ if before != NOBODY && within >> before & 1 == 1 => before,
                AttackMode::Closest => nearest,
                AttackMode::Random => draw(enemy, within) as u8,
            };
            let order = if target != NOBODY && rules.enemy_shoots {
                ATTACK + (self.allies as u8 - 1 - target)
            } else if seen != 0 {
                heading(self.seen_way(enemy, draw(enemy, seen))) as u8
            } else {
                // The dead of classic rules walk on as if they stood in the corner.
                let place = if self.units[enemy].is_alive() { [x, y] } else { [0.0; 2] };
                let [goal_x, goal_y] = self.units[enemy].goal;
                heading([goal_x - place[0], goal_y - place[1]]) as u8
            };
            (self.units[enemy].target, self.units[enemy].order) = (target, order);
        }
    }

    /// The allies that an enemy sees, those within its reach, and the nearest of these; of several the last.
    fn look_out(&self, enemy: usize) -> (UnitSet, UnitSet, u8) {
        let range = RANGE[self.units[enemy].kind()];
        let (mut seen, mut within) = (0, 0);
        let (mut least, mut nearest) = (range, NOBODY);
        for ally in (0..self.allies).rev().filter(|ally| self.sees(enemy, *ally)) {
            let distance = length(self.seen_way(enemy, ally));
            seen |= 1 << ally;
            within |= UnitSet::from(distance < range) << ally;
            if distance < least {
                (least, nearest) = (distance, ally as u8);
            }
        }
        (seen, within, nearest)
    }

    /// The way to an ally as an enemy reads it from what it sees.
    fn seen_way(&self, enemy: usize, ally: usize) -> Point {
        let sight = SIGHT[self.units[enemy].kind()];
        self.way(enemy, ally).map(|part| part / sight * sight)
    }

    /// Plays a step by the orders of all units and returns what the allies earn. `jitter` draws how many seconds more the
    /// cooldown after a shot lasts, of this tick, shooter and foe.
    pub(super) fn fight(
        &mut self,
        rules: &Rules,
        mut jitter: impl FnMut(usize, [usize; 2]) -> f32,
    ) -> f32 {
        let before = self.units.map(|unit| unit.health);
        for tick in 0..TICKS {
            self.shoot_and_move(rules, |shot| jitter(tick, shot));
            self.push_apart(rules);
        }
        self.steps += 1;
        let reward = self.reward(rules, &before);
        self.episode_return += f64::from(reward);
        reward
    }

    /// All at once: who shoots at whom is told by where all were before, and those who die still shoot.
    pub(super) fn shoot_and_move(
        &mut self,
        rules: &Rules,
        mut jitter: impl FnMut([usize; 2]) -> f32,
    ) {
        let mut damage = [0; CAPACITY];
        for unit in 0..self.count {
            let hit = self.hit(unit);
            let Unit { kind, cooldown, .. } = &mut self.units[unit];
            match hit {
                Some(foe) => {
                    damage[foe] += DAMAGE[usize::from(*kind)];
                    *cooldown = PERIOD[usize::from(*kind)] + jitter([unit, foe]);
                }
                None => *cooldown -= TICK,
            }
        }
        for (unit, damage) in self.units[..self.count].iter_mut().zip(damage) {
            if unit.is_alive() || rules.rules == RuleBook::Classic {
                let (moved, speed) = (unit.moved(), SPEED[unit.kind()]);
                for (part, moved) in unit.place.iter_mut().zip(moved) {
                    *part = (*part + moved * speed * TICK).clamp(0.0, SIDE);
                }
            }
            unit.health = u16::from(unit.health).saturating_sub(damage) as u8;
            let is_inside = |part: &f32| *part > 0.0 && *part < SIDE;
            if rules.walls_cause_death && !unit.place.iter().all(is_inside) {
                unit.health = 0;
            }
        }
    }

    /// The foe that a unit shoots at now.
    #[inline]
    fn hit(&self, unit: usize) -> Option<usize> {
        let Unit { order, cooldown, .. } = self.units[unit];
        let foe = self.foe(unit, order.checked_sub(ATTACK)?.into());
        (cooldown <= 0.0 && self.is_near(unit, foe, &RANGE)).then_some(foe)
    }

    /// Each of two units that overlap is moved by half of that, all from where they were.
    pub(super) fn push_apart(&mut self, rules: &Rules) {
        let has_body = |unit: &Unit| unit.is_alive() || rules.rules == RuleBook::Classic;
        let bodies = self.units[..self.count].iter().enumerate();
        let bodies = bodies.filter(|(_, unit)| has_body(unit));
        let bodies = bodies.fold(0, |set, (unit, _)| set | 1 << unit);
        let mut moves = [Point::default(); CAPACITY];
        for one in members(bodies) {
            for other in members(bodies & (u128::MAX << one << 1)) {
                let [x, y] = self.way(other, one);
                let [radius, more] = [one, other].map(|unit| RADIUS[self.units[unit].kind()]);
                // Hardly anybody is that near: the root is saved.
                if x * x + y * y < (radius + more) * (radius + more) {
                    let share = ((radius + more) / (length([x, y]) + 1e-6) - 1.0).max(0.0);
                    moves[one] = [moves[one][0] + x * share, moves[one][1] + y * share];
                    moves[other] = [moves[other][0] - x * share, moves[other][1] - y * share];
                }
            }
        }
        for (Unit { place: [x, y], .. }, moved) in self.units.iter_mut().zip(moves) {
            (*x, *y) = (*x + 0.5 * moved[0], *y + 0.5 * moved[1]);
        }
    }

    /// What the allies earn by what enemies have lost since.
    fn reward(&self, rules: &Rules, before: &[u8; CAPACITY]) -> f32 {
        let enemies = self.units[..self.count].iter().zip(before).skip(self.allies);
        let lost = |(enemy, before): (&Unit, &u8)| {
            f32::from(*before - enemy.health) / f32::from(HEALTH[enemy.kind()])
        };
        let damage = enemies.map(lost).sum::<f32>() / (self.count - self.allies) as f32;
        let damage = if rules.self_play_reward { 0.0 } else { damage };
        match self.alive().map(|alive| alive > 0) {
            [true, false] => damage + 1.0,
            [false, true] if rules.self_play_reward => -1.0,
            _ => damage,
        }
    }
}

/// Bytes of a battle of so many units: the layout, the sizes of both teams, the steps, the return, the units.
pub(super) fn state_bytes(units: usize) -> usize {
    1 + 2 + 4 + 8 + units * size_of::<Unit>()
}

impl Battle {
    /// Adds its bytes.
    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend([LAYOUT, self.allies as u8, (self.count - self.allies) as u8]);
        bytes.extend(self.steps.to_le_bytes());
        bytes.extend(self.episode_return.to_le_bytes());
        for unit in &self.units[..self.count] {
            let ([x, y], [goal_x, goal_y]) = (unit.place, unit.goal);
            bytes.extend([unit.kind, unit.order, unit.health, unit.target]);
            for number in [x, y, unit.cooldown, goal_x, goal_y] {
                bytes.extend(number.to_le_bytes());
            }
        }
    }

    /// Reads what [`write`](Self::write) wrote, of teams of at most these sizes.
    pub(super) fn read(bytes: &[u8], most: [usize; 2]) -> Result<Self, StateError> {
        let size = |place: usize| bytes.get(place).map_or(1, |size| usize::from(*size));
        let [allies, enemies] = [size(1), size(2)];
        let mut reader = Reader::new(bytes, state_bytes(allies + enemies))?;
        if !(1..=most[0]).contains(&allies) || !(1..=most[1]).contains(&enemies) {
            return Err(StateError::Impossible(format!("{allies} allies meet {enemies} enemies")));
        }
        reader.slice(2);
        let mut battle = Self::of(&[], &[]);
        (battle.allies, battle.count) = (allies, allies + enemies);
        (battle.steps, battle.episode_return) = (reader.u32(), reader.f64());
        reader.refuse(!battle.episode_return.is_finite(), || "its return is no number".into());
        for number in 0..battle.count {
            battle.units[number] = read_unit(&mut reader, battle.foes(number), allies);
        }
        reader.sound(battle)
    }
}

/// Reads a unit of so many foes, in a battle of so many allies.
fn read_unit(reader: &mut Reader<'_>, foes: usize, allies: usize) -> Unit {
    let [kind, order, health, target] = core::array::from_fn(|_| reader.u8());
    let full = HEALTH.get(usize::from(kind)).copied();
    reader.refuse(full.is_none(), || format!("a unit is of type {kind}"));
    reader
        .refuse(full < Some(health), || format!("a unit of type {kind} has a health of {health}"));
    let is_known = usize::from(order) < usize::from(ATTACK) + foes;
    reader.refuse(!is_known, || format!("a unit took action {order}"));
    let is_known = target == NOBODY || usize::from(target) < allies;
    reader.refuse(!is_known, || format!("an enemy shoots at ally {target}"));
    let [x, y, cooldown, goal_x, goal_y] = core::array::from_fn(|_| f32::from_bits(reader.u32()));
    let is_sound = [x, y, cooldown, goal_x, goal_y].iter().all(|number| number.is_finite());
    reader.refuse(!is_sound, || "one of its numbers is none".into());
    Unit { kind, order, health, target, place: [x, y], cooldown, goal: [goal_x, goal_y] }
}
